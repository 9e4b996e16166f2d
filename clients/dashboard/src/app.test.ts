import { beforeEach, expect, test, vi } from "vitest";
import { Page } from "./app";
import { createStore, DEFAULTS } from "./store";
import type { Opened, Rest, Shown, Verb, VerbSummary, View } from "./types";
import type { Port } from "./wire/client";
import type { FromWorker, ToWorker, Wish } from "./wire/worker_messages";

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

/** The worker's end, kept by hand. */
class Hands implements Port {
  onmessage: Port["onmessage"] = null;
  readonly heard: ToWorker[] = [];
  postMessage(message: ToWorker): void {
    this.heard.push(structuredClone(message));
  }
  terminate(): void {}
  say(message: FromWorker): void {
    this.onmessage?.({ data: message } as MessageEvent<FromWorker>);
  }
  get wish(): Wish {
    const wants = this.heard.filter((message) => message.kind === "want");
    return (wants.at(-1) as { wish: Wish }).wish;
  }
  picture(phase: number, name = "reach"): void {
    const shown: Shown = {
      ...{ verb: name, version: 1, method: "corrected", phase, time_s: phase, duration_s: 1, error: 0 },
      ...{ clamped: false, inTransition: false, root: [0, 0, 0], count: 1 },
    };
    this.say({ kind: "pictures", pictures: { main: { shown, poses: new Float32Array(7) }, other: null } });
  }
}

let port: Hands;
let page: Page;

async function start(view: Partial<View> = {}, still = false): Promise<void> {
  port = new Hands();
  const rest = {
    verbs: async () => [{ name: "arm3" }, { name: "reach" }] as VerbSummary[],
    verb: async (name: string) => (name === "reach" ? REACH : ARM),
  } as unknown as Rest;
  page = new Page(createStore({ ...DEFAULTS, ...view }), rest, port, still);
  page.start("ws://here/v1/stream");
  await vi.waitFor(() => expect(page.verb?.name).toBe(page.store.view.verb));
  page.frame(0);
}

beforeEach(() => start());

test("without a link the page shows a verb that is served, at the goal that the server chooses", () => {
  expect(page.store.view.verb).toBe("reach");
  expect(port.wish).toMatchObject({ main: { verb: "reach", playing: true, method: "" }, adverbs: [[]] });
  port.say({ kind: "opened", side: "main", opened: opened("reach", [0.12345678, 1]) });
  expect(page.store.view.goal).toEqual({ x: 0.1235, y: 1 });
  page.frame(0);
  expect(port.wish.adverbs).toEqual([[0.1235, 1]]);
});

test("another verb does not take over the goal of the one before", async () => {
  port.say({ kind: "opened", side: "main", opened: opened("reach", [0.5, 1]) });
  page.choose("arm3");
  await vi.waitFor(() => expect(page.verb?.name).toBe("arm3"));
  page.frame(0);
  expect(port.wish).toMatchObject({ main: { verb: "arm3" }, adverbs: [[]] });
  port.picture(0.3, "reach"); // still under way
  expect(page.shown.main).toBeNull();
  port.say({ kind: "opened", side: "main", opened: opened("arm3", [0.1, 0.2]) });
  expect(page.store.view.goal).toEqual({ x: 0.1, y: 0.2 });
  page.choose("arm3");
  expect(page.store.view.goal).toEqual({ x: 0.1, y: 0.2 });
});

test("a goal that moves holds the figure where it is met; what was playing plays on from there", () => {
  port.say({ kind: "opened", side: "main", opened: opened("reach", [0, 1]) });
  vi.useFakeTimers();
  const { serial } = port.wish.main.seek;
  page.aim({ x: 0.2 }, false);
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: false, seek: { serial: serial + 1, phase: 0.5 } });
  expect(port.wish.adverbs).toEqual([[0.2, 1]]);
  page.aim({ x: 0.3 }, true);
  page.frame(0);
  expect(port.wish.main.seek.serial).toBe(serial + 1);
  vi.advanceTimersByTime(1100);
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: true, seek: { serial: serial + 1 } });
  vi.useRealTimers();
});

test("while the user has stopped the motion, a goal that moves takes nothing over", () => {
  port.say({ kind: "opened", side: "main", opened: opened("reach", [0, 1]) });
  page.seek(0.2);
  page.aim({ x: 0.2 }, false);
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: false, seek: { phase: 0.2 } });
  expect(page.hold.phase).toBeNull();
});

test("a pause stands at what is shown, playing goes on from there, and an end starts over", () => {
  port.picture(0.43217);
  page.pause();
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: false, seek: { phase: 0.4322 } });
  const { serial } = port.wish.main.seek;
  page.play();
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: true, seek: { serial } });
  page.store.change({ loop: false });
  port.say({ kind: "end" });
  expect(page.store.view).toMatchObject({ playing: false, phase: 1 });
  page.play();
  page.frame(0);
  expect(port.wish.main).toMatchObject({ playing: true, seek: { phase: 0 } });
});

test("where less motion is asked for, the page stands where the goal is met", async () => {
  await start({ playing: false }, true);
  expect(page.store.view).toMatchObject({ playing: false, phase: 0.5 });
});

test("frames ask for one picture at a time, and give the arrays back", () => {
  const draws = () => port.heard.filter((message) => message.kind === "draw");
  page.frame(16);
  page.frame(32);
  expect(draws()).toHaveLength(1);
  port.picture(0.1);
  page.frame(48);
  expect(draws()).toHaveLength(2);
  expect(draws()[1]?.spare.map((array) => array.length)).toEqual([7]);
});

test("nothing is said that was said before", () => {
  const before = port.heard.length;
  for (let k = 0; k < 10; k++) page.frame(k);
  expect(port.heard.slice(before).filter((message) => message.kind === "want")).toEqual([]);
});
