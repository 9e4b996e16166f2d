import { expect, test } from "vitest";
import type { Skeleton } from "../types";
import { anatomyOf } from "./anatomy";
import { type FootPoint, footPoints, SlideMeter } from "./slide_meter";

const SKELETON = {
  names: ["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"],
  parents: [-1, 0, 1, 2, 3],
  offsets: [
    [0, 0, 0],
    [0.1, 0, 0],
    [0, -0.4, 0],
    [0, -0.4, 0],
    [0, -0.06, 0.1],
  ],
  tips: [{ parent: 4, offset: [0, -0.02, 0.05] }],
} as unknown as Skeleton;

const TOE: FootPoint = { joint: 0, pivot: true };

/** Meter after pictures at 60 per second; `path` gives x and y. */
function run(path: (t: number) => readonly [number, number], seconds: number): SlideMeter {
  const meter = new SlideMeter([TOE]);
  for (let k = 0; k <= 60 * seconds; k++) {
    const [x, y] = path(k / 60);
    meter.update(Float32Array.of(x, y, 0), k / 60);
  }
  return meter;
}

test("a foot stands on its toe joint and its heel; only the toe joint is a pivot", () => {
  const points = footPoints(anatomyOf(SKELETON));
  expect(points.map(({ joint, pivot }) => [joint, pivot])).toEqual([
    [3, false],
    [4, true],
  ]);
});

test("a foot that stays where it landed does not slide", () => {
  const meter = run((t) => [Math.min(t, 0.3), 0.02], 1);
  expect(meter.slide).toBeCloseTo(0, 6);
});

test("the slide of a stance is its largest distance from the landing", () => {
  const there = (t: number) => (t < 0.5 ? 0 : 0.1 * (Math.min(t, 0.7) - 0.5));
  expect(run((t) => [there(t), 0.02], 1).slide).toBeCloseTo(0.02, 3);
  const andBack = (t: number) => there(t) - (t < 0.8 ? 0 : 0.1 * (t - 0.8));
  expect(run((t) => [andBack(t), 0.02], 1).slide).toBeCloseTo(0.02, 3);
});

test("a foot that is high or fast does not stand, and its next stance starts again", () => {
  expect(run((t) => [0, t < 0.5 ? 0.02 : 0.08], 1).slide).toBeNull();
  expect(run((t) => [t, 0.02], 1).slide).toBeNull();
  const step = run((t) => (t < 0.5 ? [0.1 * t, 0.02] : t < 0.7 ? [0.05, 0.2] : [0.05, 0.02]), 1);
  expect(step.slide).toBeCloseTo(0, 6);
});
