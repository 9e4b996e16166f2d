import { expect, test } from "vitest";
import type { Verb } from "../types";
import { type Axes, axesOf, STILL, steer, stick, sum } from "./steering";

const UNITS = ["m/s", "rad/s", "m/s"];

function verb(units = UNITS, scale = [1, 1, 1], part: object = {}): Verb {
  const ranges = [
    [-0.7, 4],
    [-1.6, 1.6],
    [-1, 1],
  ] as const;
  const names = ["ahead", "turning", "across"];
  return {
    looping: true,
    measure: { kind: "root_velocity", adverbs: names },
    adverbs: names.map((name, k) => {
      const [min, max] = (ranges[k] as readonly [number, number]).map((value) => value * (scale[k] as number));
      return { name, unit: units[k], min, max };
    }),
    ...part,
  } as unknown as Verb;
}

const AXES = axesOf(verb()) as Axes;

test("no input stands still", () => {
  expect(steer(AXES, STILL)).toEqual({ ahead: 0, turning: 0, across: 0 });
});

test("half of the forward axis walks, all of it runs within the range, back is slow", () => {
  expect(steer(AXES, { ...STILL, forward: 0.5 }).ahead).toBeCloseTo(1.4);
  expect(steer(AXES, { ...STILL, forward: 1 }).ahead).toBeCloseTo(3.4);
  expect(steer(AXES, { ...STILL, forward: -1 }).ahead).toBe(-0.7);
  const slow = axesOf(verb(UNITS, [0.25, 1, 1])) as Axes;
  expect(steer(slow, { ...STILL, forward: 1 }).ahead).toBe(1);
});

test("left turns and steps are positive, and a run turns less than a walk", () => {
  const walk = steer(AXES, { forward: 0.5, turn: 1, side: 1 });
  expect([walk.turning, walk.across]).toEqual([1.6, 0.8]);
  const run = steer(AXES, { forward: 1, turn: -1, side: -1 });
  expect(run.turning).toBeGreaterThan(-1);
  expect(run.turning).toBeLessThan(-0.9);
  expect(run.across).toBe(0);
});

test("adverbs are in the units of the verb", () => {
  const axes = axesOf(verb(["km/h", "deg/s", "m/s"], [3.6, 180 / Math.PI, 1])) as Axes;
  const goal = steer(axes, { forward: 0.5, turn: 1, side: 0 });
  expect(goal.ahead).toBeCloseTo(5.04);
  expect(goal.turning).toBeCloseTo((1.6 * 180) / Math.PI);
});

test("verbs without a measured root velocity cannot be driven", () => {
  expect(axesOf(verb(UNITS, [1, 1, 1], { looping: false }))).toBeNull();
  expect(
    axesOf(verb(UNITS, [1, 1, 1], { measure: { kind: "jump", adverbs: ["ahead", "turning", "across"] } })),
  ).toBeNull();
});

test("a stick has a dead zone and a circular range", () => {
  expect(stick(0.1, 0.1)).toEqual([0, 0]);
  expect(stick(0, -1)).toEqual([0, -1]);
  expect(Math.hypot(...stick(1, 1))).toBeCloseTo(1);
});

test("devices add up to at most 1", () => {
  expect(sum([STILL, { forward: 0.7, turn: 0, side: 0 }, { forward: 0.7, turn: -0.25, side: 0 }])).toEqual({
    ...{ forward: 1, turn: -0.25, side: 0 },
  });
});
