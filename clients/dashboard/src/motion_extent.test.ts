import { PerspectiveCamera } from "three";
import { expect, test } from "vitest";
import { extremeExamples, extremePoints, motionExtent } from "./motion_extent";
import { anatomyOf } from "./scene/anatomy";
import { figureRect, isOffscreen } from "./scene/figure_rect";
import { layoutOf } from "./scene/layout";
import type { V3 } from "./scene/vec";
import type { Rest, Verb } from "./types";

const verb = {
  ...{ name: "jump", looping: false, measure: { kind: "jump", effector: null, adverbs: [] } },
  adverbs: [{ name: "distance" }, { name: "height" }],
  examples: [
    { adverbs: { distance: 1, height: 0.2 } },
    { adverbs: { distance: 0, height: 0.3 } },
    { adverbs: { distance: 2, height: 0.1 } },
    { adverbs: { distance: 1.5, height: 0.6 } },
  ],
  skeleton: { names: ["Hips"], parents: [-1], offsets: [[0, 0, 0]], tips: [{ parent: 0, offset: [0, 0.8, 0] }] },
} as unknown as Verb;

/** A jump of one joint: forward by its distance, up by its height. */
function records(distance: number, height: number): ArrayBuffer {
  const frames = 13;
  const view = new DataView(new ArrayBuffer(52 * frames));
  for (let k = 0; k < frames; k++) {
    const phase = k / (frames - 1);
    const numbers = [phase, phase, 0, 1, 0, 1 + 4 * height * phase * (1 - phase), distance * phase, 0, 0, 0, 1];
    numbers.forEach((value, i) => {
      view.setFloat32(52 * k + 8 + 4 * i, value, true);
    });
  }
  return view.buffer;
}

const rest = {
  sequence: async (_: string, { adverbs }: { adverbs: Record<string, number> }) =>
    records(adverbs.distance as number, adverbs.height as number),
} as unknown as Rest;

const highest = (points: readonly V3[], axis: 0 | 1 | 2) => Math.max(...points.map((p) => p[axis]));

test("the examples with the extreme values of each adverb are chosen, each once", () => {
  const chosen = extremeExamples(verb).map(({ distance, height }) => [distance, height]);
  expect(chosen).toEqual([
    [0, 0.3],
    [2, 0.1],
    [1.5, 0.6],
  ]);
});

test("the extent has the height of the highest jump with the head, and the longest travel", async () => {
  const points = await motionExtent(rest, verb);
  expect(highest(points, 1)).toBeCloseTo(1 + 0.6 + 0.8, 2);
  expect(highest(points, 2)).toBeCloseTo(2, 5);
});

test("the extent of a looping verb does not travel", async () => {
  expect(highest(await motionExtent(rest, { ...verb, looping: true }), 2)).toBeCloseTo(0, 5);
});

test("the camera frame contains the extent", async () => {
  const points = await motionExtent(rest, verb);
  const { frame } = layoutOf(anatomyOf(verb.skeleton), verb, [], points);
  expect(highest(frame(1).points, 1)).toBeCloseTo(2.4, 2);
  expect(highest(frame(1).points, 2)).toBeCloseTo(2, 5);
});

test("the extreme points of a cube are its corners", () => {
  const cube = [0, 1].flatMap((x) => [0, 1].flatMap((y) => [0, 1].map((z): V3 => [x, y, z])));
  expect(extremePoints([...cube, [0.5, 0.5, 0.5]])).toHaveLength(8);
  expect(extremePoints([])).toEqual([]);
});

test("a figure beside or behind the camera is off-screen, one in view is not", () => {
  const camera = new PerspectiveCamera(32, 2, 0.05, 200);
  camera.position.set(0, 0, 5);
  camera.updateMatrixWorld();
  const at = (x: number, z: number) =>
    isOffscreen(figureRect(Float32Array.from([x, 0, z]), camera, 800, 400), 800, 400);
  expect([at(0, 0), at(9, 0), at(-9, 0), at(0, 9)]).toEqual([false, true, true, true]);
});
