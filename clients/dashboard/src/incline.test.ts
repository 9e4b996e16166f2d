import { Sequence } from "adverb-client";
import { expect, test, vi } from "vitest";
import { Inclines, inclineOf } from "./incline";
import { followSlope, groundHeight, inclineAt } from "./scene/slope";
import type { Incline, Rest, Skeleton, Verb } from "./types";

const SKELETON = {
  names: ["Hips"],
  parents: [-1],
  offsets: [[0, 0, 0]],
  tips: [{ parent: 0, offset: [0, -0.5, 0] }],
} as unknown as Skeleton;

/** One cycle that travels 2 m along (sin course, cos course), rises by `gradient` and bobs by 4 cm. */
function records(gradient: number, course = 0): ArrayBuffer {
  const frames = 61;
  const view = new DataView(new ArrayBuffer(52 * frames));
  for (let k = 0; k < frames; k++) {
    const phase = k / (frames - 1);
    const along = 2 * phase;
    const bob = 0.02 * (1 - Math.cos(4 * Math.PI * phase));
    const root = [along * Math.sin(course), 0.5 + gradient * along + bob, along * Math.cos(course)];
    [phase, phase, 0, 1, ...root, 0, 0, 0, 1].forEach((value, i) => {
      view.setFloat32(52 * k + 8 + 4 * i, value, true);
    });
  }
  return view.buffer;
}

const incline = (gradient: number, course = 0) => inclineOf(new Sequence(records(gradient, course), 1), SKELETON);

test("the gradient is the rise of a cycle over its travel, in any direction", () => {
  for (const course of [0, 1, -2.5]) {
    expect(incline(0.25, course).gradient).toBeCloseTo(0.25, 5);
    expect(inclineAt(incline(0.25, course), 0.3).turn).toBeCloseTo(course, 4);
  }
  expect(incline(0).gradient).toBeCloseTo(0, 6);
});

test("the ground touches the lowest point of the cycle, and the root bobs above it", () => {
  expect(inclineAt(incline(-0.2), 0).height).toBeCloseTo(0.5, 4);
  expect(inclineAt(incline(-0.2), 0.25).height).toBeCloseTo(0.54, 3);
});

test("the ground follows a climb over many cycles and a gradient that changes", () => {
  let slope = null;
  const at = (phase: number, gradient: number) => {
    const bob = 0.02 * (1 - Math.cos(4 * Math.PI * phase));
    return Float32Array.of(0, 0.5 + gradient * 2 * phase + bob, 2 * phase);
  };
  for (let k = 0; k <= 600; k++) slope = followSlope(slope, incline(0.2), (k / 60) % 1, at(k / 60, 0.2), 0, 1 / 60);
  expect(slope?.gradient).toBeCloseTo(0.2, 5);
  expect(groundHeight(slope, 0, 20)).toBeCloseTo(4, 2);
  expect(groundHeight(slope, 3, 19)).toBeCloseTo(3.8, 2);
  for (let k = 0; k < 120; k++) slope = followSlope(slope, incline(0), 0, Float32Array.of(0, 4.5, 20), 0, 1 / 60);
  expect(groundHeight(slope, 5, 5)).toBeCloseTo(4, 2);
  expect(groundHeight(null, 5, 5)).toBe(0);
});

test("only verbs that climb request the incline of every goal", async () => {
  vi.useFakeTimers();
  const verb = (climb: number) =>
    ({
      ...{ name: "walk", looping: true, skeleton: SKELETON, adverbs: [{ name: "slope" }] },
      examples: [{ adverbs: { slope: -climb } }, { adverbs: { slope: climb } }],
    }) as unknown as Verb;
  const sequence = vi.fn(async (_: string, { adverbs }: { adverbs: Record<string, number> }) =>
    records(adverbs.slope as number),
  );
  const shown: Incline[] = [];
  const inclines = new Inclines({ sequence } as unknown as Rest, (each) => shown.push(each));
  await inclines.select(verb(0), { slope: 0 });
  inclines.move({ slope: 0.1 });
  await vi.runAllTimersAsync();
  expect([sequence.mock.calls.length, shown.length]).toEqual([2, 0]);
  await inclines.select(verb(0.3), { slope: 0.1 });
  for (const slope of [0.15, 0.2]) inclines.move({ slope });
  await vi.runAllTimersAsync();
  expect(shown.map(({ gradient }) => Number(gradient.toFixed(3)))).toEqual([0.1, 0.2]);
  vi.useRealTimers();
});
