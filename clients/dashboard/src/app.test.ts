import { beforeEach, expect, test, vi } from "vitest";
import { Page } from "./app";
import { createStore, DEFAULTS } from "./store";
import type { Opened, Rest, Shown, Verb, VerbSummary, View } from "./types";
import type { Port } from "./wire/client";
import type { FromWorker, StreamTarget, ToWorker } from "./wire/worker_messages";

const REACH = verb("reach", ["x", "y"]);
const ARM = verb("arm3", ["x", "y"]);

function verb(name: string, adverbs: string[], version = 1): Verb {
  return {
    ...{ name, version, default_method: "corrected", methods: ["corrected", "rbf"], looping: false },
    ...{ keytime_names: ["start", "apex", "end"], keytime_phases: [0, 0.5, 1] },
    ...{ measure: { keytime: "apex", unit: "m" }, examples: [] },
    adverbs: adverbs.map((each) => ({ name: each })),
  } as unknown as Verb;
}

function opened(name: string, goals: number[]): Opened {
  const adverbs = goals.map((goal, k) => ({ name: ["x", "y"][k], goal }));
  return { verb: name, version: 1, follow: [0.4, 0.6], adverbs } as unknown as Opened;
}

/** Worker port driven by the tests. */
class FakePort implements Port {
  onmessage: Port["onmessage"] = null;
  readonly messages: ToWorker[] = [];
  postMessage(message: ToWorker): void {
    this.messages.push(structuredClone(message));
  }
  terminate(): void {}
  notify(message: FromWorker): void {
    this.onmessage?.({ data: message } as MessageEvent<FromWorker>);
  }
  get target(): StreamTarget {
    const targets = this.messages.filter((message) => message.kind === "setTarget");
    return (targets.at(-1) as { target: StreamTarget }).target;
  }
  picture(phase: number, name = "reach"): void {
    const shown: Shown = {
      ...{ verb: name, version: 1, method: "corrected", phase, time_s: phase, duration_s: 1, error: 0 },
      ...{ clamped: false, inTransition: false, root: [0, 0, 0], count: 1 },
    };
    this.notify({ kind: "pictures", pictures: { main: { shown, poses: new Float32Array(7) }, comparison: null } });
  }
}

let port: FakePort;
let page: Page;
let served: VerbSummary[];

async function start(view: Partial<View> = {}, reducedMotion = false): Promise<void> {
  port = new FakePort();
  served = [
    { name: "arm3", version: 1 },
    { name: "reach", version: 1 },
  ] as VerbSummary[];
  const rest = {
    verbs: async () => served,
    verb: async (name: string) => (name === "reach" ? REACH : ARM),
  } as unknown as Rest;
  page = new Page(createStore({ ...DEFAULTS, ...view }), rest, port, reducedMotion);
  page.start("ws://here/v1/stream");
  await vi.waitFor(() => expect(page.verb?.name).toBe(page.store.view.verb));
  page.frame(0);
}

beforeEach(() => start());

test("without a link the page shows the default verb at the server's default goal", () => {
  expect(page.store.view.verb).toBe("reach");
  expect(port.target).toMatchObject({ main: { verb: "reach", playing: true, method: "" }, adverbs: [[]] });
  port.notify({ kind: "opened", role: "main", opened: opened("reach", [0.12345678, 1]) });
  expect(page.store.view.goal).toEqual({ x: 0.1235, y: 1 });
  page.frame(0);
  expect(port.target.adverbs).toEqual([[0.1235, 1]]);
});

test("another verb does not inherit the goal", async () => {
  port.notify({ kind: "opened", role: "main", opened: opened("reach", [0.5, 1]) });
  page.selectVerb("arm3");
  await vi.waitFor(() => expect(page.verb?.name).toBe("arm3"));
  page.frame(0);
  expect(port.target).toMatchObject({ main: { verb: "arm3" }, adverbs: [[]] });
  port.picture(0.3, "reach"); // still displayed
  expect(page.shown.main).toBeNull();
  port.notify({ kind: "opened", role: "main", opened: opened("arm3", [0.1, 0.2]) });
  expect(page.store.view.goal).toEqual({ x: 0.1, y: 0.2 });
  page.selectVerb("arm3");
  expect(page.store.view.goal).toEqual({ x: 0.1, y: 0.2 });
});

test("a moving goal pauses playback at its keytime, and playback resumes there", () => {
  port.notify({ kind: "opened", role: "main", opened: opened("reach", [0, 1]) });
  vi.useFakeTimers();
  const { serial } = port.target.main.seek;
  page.setGoal({ x: 0.2 }, false);
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: false, seek: { serial: serial + 1, phase: 0.5 } });
  expect(port.target.adverbs).toEqual([[0.2, 1]]);
  page.setGoal({ x: 0.3 }, true);
  page.frame(0);
  expect(port.target.main.seek.serial).toBe(serial + 1);
  vi.advanceTimersByTime(1100);
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: true, seek: { serial: serial + 1 } });
  vi.useRealTimers();
});

test("a moving goal does not change the phase of a paused motion", () => {
  port.notify({ kind: "opened", role: "main", opened: opened("reach", [0, 1]) });
  page.seek(0.2);
  page.setGoal({ x: 0.2 }, false);
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: false, seek: { phase: 0.2 } });
  expect(page.pauseAtGoal.phase).toBeNull();
});

test("pause keeps the displayed phase, play continues there and restarts at the end", () => {
  port.picture(0.43217);
  page.pause();
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: false, seek: { phase: 0.4322 } });
  const { serial } = port.target.main.seek;
  page.play();
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: true, seek: { serial } });
  page.store.change({ loop: false });
  port.notify({ kind: "end" });
  expect(page.store.view).toMatchObject({ playing: false, phase: 1 });
  page.play();
  page.frame(0);
  expect(port.target.main).toMatchObject({ playing: true, seek: { phase: 0 } });
});

test("with reduced motion the page starts paused at the goal's keytime", async () => {
  await start({ playing: false }, true);
  expect(page.store.view).toMatchObject({ playing: false, phase: 0.5 });
});

test("at most one picture is requested at a time, and arrays are returned", () => {
  const draws = () => port.messages.filter((message) => message.kind === "draw");
  page.frame(16);
  page.frame(32);
  expect(draws()).toHaveLength(1);
  port.picture(0.1);
  page.frame(48);
  expect(draws()).toHaveLength(2);
  expect(draws()[1]?.spare.map((array) => array.length)).toEqual([7]);
});

test("an unchanged target is not sent again", () => {
  const before = port.messages.length;
  for (let k = 0; k < 10; k++) page.frame(k);
  expect(port.messages.slice(before).filter((message) => message.kind === "setTarget")).toEqual([]);
});

test("a verb deleted by another client disappears, and the page leaves it with a notice", async () => {
  const notices: string[] = [];
  page.on("notice", ({ text }) => notices.push(text));
  served = served.filter(({ name }) => name !== "reach");
  port.notify({ kind: "refused", role: "main", code: "unknown_verb", detail: "unknown verb" });
  await vi.waitFor(() => expect(page.verb?.name).toBe("arm3"));
  expect(page.verbs.map(({ name }) => name)).toEqual(["arm3"]);
  expect(notices).toEqual(["Verb “reach” was deleted."]);
});

test("the list of verbs is compared with the server every few seconds", async () => {
  vi.useFakeTimers();
  page.start("ws://here/v1/stream");
  await vi.advanceTimersByTimeAsync(100);
  served = [...served, { name: "wave", version: 1 } as VerbSummary];
  await vi.advanceTimersByTimeAsync(6000);
  expect(page.verbs.map(({ name }) => name)).toEqual(["arm3", "reach", "wave"]);
  expect(page.store.view.verb).toBe("reach");
  page.stop();
  vi.useRealTimers();
});
