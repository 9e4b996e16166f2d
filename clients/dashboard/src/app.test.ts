import { ResponseError } from "adverb-client";
import { afterAll, beforeAll, beforeEach, describe, expect, test, vi } from "vitest";
import { Access, type Caller } from "./access/access";
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
      ...{ verb: name, version: 1, method: "corrected", phase, timeS: phase, durationS: 1, error: 0 },
      ...{ support: null, clamped: false, inTransition: false, root: [0, 0, 0], count: 1 },
    };
    this.notify({ kind: "pictures", pictures: { main: { shown, poses: new Float32Array(7) }, comparison: null } });
  }
}

const ANYONE: Caller = {
  required: false,
  id: "",
  name: "",
  scopes: ["pose", "author", "refine", "admin"],
  expires_at: null,
};

let port: FakePort;
let page: Page;
let access: Access;
/** What `GET /v1/access` responds. */
let caller = ANYONE;
let served: VerbSummary[];

async function start(view: Partial<View> = {}, reducedMotion = false, more: Verb[] = []): Promise<void> {
  port = new FakePort();
  const known = [ARM, REACH, ...more];
  served = known.map(({ name, version }) => ({ name, version })) as VerbSummary[];
  const rest = {
    verbs: async () => served,
    verb: async (name: string) => known.find((each) => each.name === name),
  } as unknown as Rest;
  access = new Access(null, async () => caller);
  page = new Page(createStore({ ...DEFAULTS, ...view }), rest, access, port, reducedMotion);
  page.start("ws://here/v1/stream");
  await vi.waitFor(() => expect(page.verb?.name).toBe(page.store.view.verb));
  page.frame(0);
}

beforeEach(() => {
  caller = ANYONE;
  return start();
});

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

describe("drive mode", () => {
  const skeleton = { names: ["Hips"], parents: [-1] };
  const speeds = ["ahead", "turning", "across"];
  const walk = {
    ...verb("locomotion", speeds),
    ...{ looping: true, skeleton, measure: { kind: "root_velocity", adverbs: speeds } },
    adverbs: speeds.map((name) => ({ name, unit: "m/s", min: -1, max: 4 })),
  } as unknown as Verb;
  const punch = { ...verb("punch", ["x", "y"]), skeleton } as unknown as Verb;
  const kick = { ...punch, name: "kick", skeleton: { names: ["Root"], parents: [-1] } } as unknown as Verb;
  let keyboard = new EventTarget();
  const press = (code: string, type = "keydown") =>
    keyboard.dispatchEvent(Object.assign(new Event(type, { cancelable: true }), { code }));

  beforeAll(() => {
    // the keyboard needs elements only to find fields that are typed in
    vi.stubGlobal("Element", class {});
    vi.stubGlobal("document", { body: { closest: () => null } });
  });

  afterAll(() => void vi.unstubAllGlobals());

  async function drive(view: Partial<View> = {}): Promise<void> {
    await start(view, false, [walk, punch, kick]);
    keyboard = new EventTarget();
    page.drive.keyboard.listen(keyboard as Window);
    await vi.waitFor(() => expect(page.drive.has("punch")).toBe(page.drive.active));
  }

  test("is what the page starts with, but not what a link to a verb opens", async () => {
    await drive();
    expect([page.store.view.verb, page.drive.active]).toEqual(["locomotion", true]);
    await drive({ verb: "reach" });
    expect([page.store.view.verb, page.drive.active]).toEqual(["reach", false]);
    await start({}, true, [walk]);
    expect([page.store.view.verb, page.drive.active]).toEqual(["reach", false]);
  });

  test("keys set the goal, and releasing them stands still", async () => {
    await drive();
    expect(port.target.adverbs).toEqual([[0, 0, 0]]);
    press("KeyW");
    page.frame(16);
    expect(port.target.adverbs).toEqual([[1.4, 0, 0]]);
    press("KeyW", "keyup");
    page.frame(32);
    expect(port.target.adverbs).toEqual([[0, 0, 0]]);
  });

  test("an action switches the verb, and its end switches back", async () => {
    await drive();
    press("KeyJ");
    page.frame(16);
    expect(port.target.main).toMatchObject({ verb: "punch", names: ["x", "y"], switches: true, loop: false });
    port.picture(0.5, "punch");
    expect(page.shown.main?.verb).toBe("punch");
    port.notify({ kind: "end" });
    page.frame(32);
    expect(port.target).toMatchObject({ main: { verb: "locomotion", loop: true }, adverbs: [[0, 0, 0]] });
    expect(page.store.view.playing).toBe(true);
  });

  test("verbs on another skeleton are not offered", async () => {
    await drive();
    expect([page.drive.has("kick"), page.drive.has("jump")]).toEqual([false, false]);
    press("KeyK");
    page.frame(16);
    expect(port.target.main.verb).toBe("locomotion");
  });

  test("a refused switch returns to the steered verb", async () => {
    await drive();
    page.drive.act("punch");
    page.frame(16);
    port.notify({ kind: "refused", role: "main", code: "skeleton_mismatch", detail: "no" });
    page.frame(32);
    expect(port.target.main.verb).toBe("locomotion");
  });
});

describe("keys", () => {
  const POSE: Caller = { ...ANYONE, required: true, id: "1", name: "game", scopes: ["pose"] };
  const keys = () => port.messages.flatMap((message) => (message.kind === "key" ? [message.key] : []));

  test("a stream whose key was revoked stays closed until there is another", async () => {
    port.notify({ kind: "unauthenticated", key: "", detail: "the key was revoked or has expired" });
    expect(access.problem).toBe("the key was revoked or has expired");
    expect(keys().at(-1)).toBeNull();
    caller = POSE;
    await access.give("adv_2");
    expect(keys().at(-1)).toBe("adv_2");
  });

  test("a revoked key that was replaced meanwhile needs no prompt", async () => {
    await access.give("adv_2");
    port.notify({ kind: "unauthenticated", key: "", detail: "revoked" });
    expect(access.problem).toBeNull();
    expect(keys().at(-1)).toBe("adv_2");
  });

  test("without the scope for streams none is opened", async () => {
    caller = { ...POSE, scopes: ["author"] };
    await access.give("adv_3");
    expect(keys().at(-1)).toBeNull();
  });

  test("a forgotten key is not sent any more, and what none permits is requested", async () => {
    await access.give("adv_4");
    caller = POSE;
    page.forgetKey();
    expect(keys().at(-1)).toBe("");
    await vi.waitFor(() => expect(access.caller).toEqual(POSE));
  });
});

test("after too many requests the list of verbs is requested again after the stated time, and once at a time", async () => {
  vi.useFakeTimers();
  let requests = 0;
  Object.assign(page.rest, {
    verbs: async () => {
      requests++;
      throw new ResponseError(429, "too_many_requests", "too many", [], 12_000);
    },
  });
  page.start("ws://here/v1/stream"); // its first request fails
  await vi.advanceTimersByTimeAsync(100);
  expect(requests).toBe(1);
  await vi.advanceTimersByTimeAsync(5000); // refreshed
  expect(requests).toBe(2);
  await vi.advanceTimersByTimeAsync(6000);
  expect(requests).toBe(2);
  await vi.advanceTimersByTimeAsync(7000);
  expect(requests).toBeGreaterThan(2);
  page.stop();
  vi.useRealTimers();
});
