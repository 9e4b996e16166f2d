import fc from "fast-check";
import { expect, test } from "vitest";
import {
  confidenceLevel,
  confidenceText,
  keyFrames,
  moved,
  nearest,
  nudged,
  rangeOf,
  shareOf,
  timeAt,
} from "./timeline";

const SPAN = { start: 1, end: 3, fps: 20 };
const KEYTIMES = [1, 2, 3];

test("times and positions of the line belong together", () => {
  fc.assert(
    fc.property(fc.double({ min: 1, max: 3, noNaN: true }), (timeS) => {
      expect(timeAt(SPAN, 40 + 200 * shareOf(SPAN, timeS), 40, 200)).toBeCloseTo(timeS, 9);
    }),
  );
  expect(timeAt(SPAN, 0, 40, 200)).toBe(1);
  expect(timeAt(SPAN, 999, 40, 200)).toBe(3);
  expect(shareOf({ start: 1, end: 1, fps: 20 }, 1)).toBe(0);
});

test("a keytime stays between its neighbours, one frame apart, for any requested time", () => {
  const sorted = fc
    .uniqueArray(fc.integer({ min: 0, max: 40 }), { minLength: 2, maxLength: 6 })
    .map((frames) => frames.sort((a, b) => a - b).map((frame) => 1 + frame / 20));
  fc.assert(
    fc.property(sorted, fc.nat(5), fc.double({ min: -10, max: 10, noNaN: true }), (keytimes, index, timeS) => {
      const k = index % keytimes.length;
      const next = moved(SPAN, keytimes, k, timeS);
      const [low, high] = rangeOf(SPAN, keytimes, k);
      expect(next[k]).toBeGreaterThanOrEqual(low);
      expect(next[k]).toBeLessThanOrEqual(high);
      for (let i = 1; i < next.length; i++) expect(next[i]).toBeGreaterThan(next[i - 1] as number);
      expect(next.filter((each, i) => each !== keytimes[i]).length).toBeLessThanOrEqual(1);
    }),
  );
});

test("a moved keytime is rounded to 0.1 ms", () => {
  expect(moved(SPAN, KEYTIMES, 1, 1.7000449)).toEqual([1, 1.7, 3]);
  expect(moved(SPAN, KEYTIMES, 1, 9)).toEqual([1, 2.95, 3]);
  expect(moved(SPAN, KEYTIMES, 0, -5)).toEqual([1, 2, 3]);
});

test("keys move by frames", () => {
  expect(nudged(SPAN, KEYTIMES, 1, keyFrames("ArrowRight", false) as number)).toEqual([1, 2.05, 3]);
  expect(nudged(SPAN, KEYTIMES, 1, keyFrames("ArrowLeft", true) as number)).toEqual([1, 1.5, 3]);
  expect(keyFrames("PageDown", false)).toBe(-10);
  expect(keyFrames("a", false)).toBeNull();
});

test("a press grabs the nearest keytime", () => {
  expect(nearest(SPAN, KEYTIMES, 0.45)).toEqual({ k: 1, away: expect.closeTo(0.05, 9) });
  expect(nearest(SPAN, [], 0.45)).toBeNull();
});

test("keytimes below a confidence of 0.5 are to be checked", () => {
  expect(confidenceText(0.43)).toBe("confidence 0.43, check");
  expect(confidenceText(0.5)).toBe("confidence 0.50");
  expect([0.2, 0.6, 0.9].map(confidenceLevel)).toEqual(["low", "middle", "high"]);
});
