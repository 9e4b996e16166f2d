import fc from "fast-check";
import { expect, test, vi } from "vitest";
import { createStore, DEFAULTS, readView, syncAddress, writeView } from "./store";
import type { Comparison, View } from "./types";

const number = fc.double({ min: -1e9, max: 1e9, noNaN: true }).map((value) => value + 0); // no negative zero in a link
const name = fc.string({ minLength: 1, maxLength: 40 });
const compare: fc.Arbitrary<Comparison> = fc.oneof(
  fc.constant<Comparison>({ kind: "none" }),
  name.map((method): Comparison => ({ kind: "method", method })),
  fc.integer({ min: 1, max: 2 ** 32 - 1 }).map((version): Comparison => ({ kind: "version", version })),
);
const view: fc.Arbitrary<View> = fc.record<View>({
  verb: fc.string({ maxLength: 40 }),
  method: fc.string({ maxLength: 40 }),
  goal: fc.dictionary(name, number, { maxKeys: 6, noNullPrototype: true }),
  phase: fc.double({ min: 0, max: 1, noNaN: true }).map((value) => value + 0),
  playing: fc.boolean(),
  speed: fc.double({ min: -2, max: 2, noNaN: true }).map((value) => value + 0),
  loop: fc.boolean(),
  fps: fc.integer({ min: 1, max: 120 }),
  encoding: fc.constantFrom("f32", "q48", "q32"),
  crowd: fc.integer({ min: 1, max: 2000 }),
  crowdPoses: fc.boolean(),
  compare,
  hull: fc.boolean(),
  examples: fc.boolean(),
  pseudo: fc.boolean(),
  follow: fc.boolean(),
  detail: fc.constantFrom("high", "low"),
  theme: fc.constantFrom("auto", "light", "dark"),
  drive: fc.boolean(),
  panel: fc.constantFrom("verb", "quality", "versions", "service", "upload"),
  draft: fc.string({ maxLength: 40 }),
  clip: fc.string({ maxLength: 40 }),
  figure: fc.string({ maxLength: 40 }),
  figureGoal: fc.constantFrom("scaled", "world"),
  camera: fc.option(fc.array(number, { minLength: 6, maxLength: 6 })),
  across: fc.string({ maxLength: 40 }),
  up: fc.string({ maxLength: 40 }),
  map: fc.constantFrom("error", "smoothness", "support"),
  maps: fc.array(
    name.filter((each) => !each.includes(",")),
    { maxLength: 4 },
  ),
  slice: fc.option(fc.dictionary(name, number, { minKeys: 1, maxKeys: 6, noNullPrototype: true })),
});

test("every view survives a round trip through its link", () => {
  fc.assert(
    fc.property(view, (original) => {
      expect(readView(writeView(original))).toEqual(original);
    }),
    { numRuns: 300 },
  );
});

test("every field changes the link, and defaults are omitted", () => {
  expect(writeView(DEFAULTS)).toBe("");
  const other: View = {
    ...{ verb: "kick", method: "rbf", goal: { x: 1 }, phase: 0.5, playing: false, speed: -1, loop: false, fps: 30 },
    ...{
      encoding: "q48",
      crowd: 2,
      crowdPoses: true,
      compare: { kind: "version", version: 3 },
      hull: false,
      examples: false,
    },
    ...{
      pseudo: true,
      follow: false,
      detail: "low",
      theme: "dark",
      drive: true,
      panel: "upload",
      draft: "d1",
      clip: "far",
      figure: "hero.vrm",
      figureGoal: "world",
      camera: [1, 2, 3, 4, 5, 6],
    },
    ...{ across: "x", up: "y", map: "smoothness", maps: ["rbf", "knn"], slice: { z: 1 } },
  };
  for (const key of Object.keys(DEFAULTS) as (keyof View)[]) {
    const link = writeView({ ...DEFAULTS, [key]: other[key] });
    expect(link, key).not.toBe("");
    expect(readView(link)[key], key).toEqual(other[key]);
  }
});

test.each([
  ["fps=0", "fps"],
  ["fps=1e9", "fps"],
  ["fps=12.5", "fps"],
  ["fps=", "fps"],
  ["speed=NaN", "speed"],
  ["speed=Infinity", "speed"],
  ["phase=2", "phase"],
  ["crowd=100000", "crowd"],
  ["playing=maybe", "playing"],
  ["encoding=weights", "encoding"],
  ["compare=method:", "compare"],
  ["compare=version:-1", "compare"],
  ["camera=1,2,3", "camera"],
  ["camera=1,2,3,4,5,x", "camera"],
  [`verb=${"x".repeat(500)}`, "verb"],
  ["at.x=left", "goal"],
  ["maps=rbf,,knn", "maps"],
  [`maps=${"a,".repeat(40)}a`, "maps"],
  ["slice.x=", "slice"],
] as const)("'%s' falls back", (words, key) => {
  expect(readView(`#${words}`)[key]).toEqual(DEFAULTS[key]);
});

test("any text parses to a view", () => {
  fc.assert(
    fc.property(fc.string({ maxLength: 200 }), (text) => {
      const { goal, ...rest } = readView(text);
      expect(Object.keys({ goal, ...rest }).sort()).toEqual(Object.keys(DEFAULTS).sort());
    }),
  );
});

test("listeners are called once per change of their keys", () => {
  const store = createStore(DEFAULTS);
  const listener = vi.fn();
  const stop = store.on(["fps", "loop"], listener);
  store.change({ fps: 60, goal: { x: 1 } });
  expect(listener).not.toHaveBeenCalled();
  store.change({ fps: 30, loop: false });
  expect(listener).toHaveBeenCalledTimes(1);
  expect(listener.mock.calls[0]?.slice(0, 2).map((each: View) => each.fps)).toEqual([30, 60]);
  store.change({ goal: { x: 1 } });
  stop();
  store.change({ fps: 24 });
  expect(listener).toHaveBeenCalledTimes(1);
});

/** A window with a session history. */
function fakeWindow() {
  const entries = [""];
  const state = { at: 0, onPop: () => {} };
  const location = {
    pathname: "/",
    get hash() {
      return entries[state.at] as string;
    },
  };
  const history = {
    replaceState: (_: unknown, __: string, address: string) => {
      entries[state.at] = address;
    },
    pushState: (_: unknown, __: string, address: string) => {
      entries.splice(++state.at, entries.length, address);
    },
  };
  const go = (by: number) => {
    state.at += by;
    state.onPop();
  };
  const addEventListener = (_: string, then: () => void) => {
    state.onPop = then;
  };
  return { page: { location, history, addEventListener } as unknown as Window, entries, go };
}

test("another verb or tab adds a history entry, other changes replace it, and back restores the view", () => {
  vi.useFakeTimers();
  const { page, entries, go } = fakeWindow();
  const store = createStore({ ...DEFAULTS, verb: "reach" });
  syncAddress(store, page);
  for (const x of [0.1, 0.2, 0.3]) store.change({ goal: { x } });
  store.change({ camera: [1, 2, 3, 4, 5, 6] });
  vi.advanceTimersByTime(1000);
  expect(entries).toHaveLength(1);
  store.change({ goal: { x: 0.4 } });
  const before = store.view;
  store.change({ verb: "kick", goal: {}, camera: null }, true);
  store.change({ goal: { y: 1 } });
  store.change({ panel: "quality" }, true);
  vi.advanceTimersByTime(1000);
  expect(entries).toHaveLength(3);
  go(-1);
  expect(store.view).toMatchObject({ verb: "kick", panel: "verb", goal: { y: 1 } });
  go(-1);
  expect(store.view).toEqual(before);
  go(2);
  expect(store.view).toMatchObject({ verb: "kick", panel: "quality" });
  vi.advanceTimersByTime(1000);
  expect(entries).toHaveLength(3);
  vi.useRealTimers();
});
