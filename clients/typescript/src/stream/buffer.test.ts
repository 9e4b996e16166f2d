import fc from "fast-check";
import { expect, test } from "vitest";
import { EXTRAPOLATE_MS, FADE_MS, FRAMES_KEPT, type Frame, JitterBuffer, MOST_LATE_MS } from "./buffer.js";
import { Lateness } from "./clock.js";

const STEP = 1000 / 60;
const DURATION = 2;

/** A figure of one joint that moves along x by one metre per second, and rotates about y by one radian per second. */
function frameAt(dueMs: number, phase = (dueMs / 1000 / DURATION) % 1): Frame {
  const seconds = dueMs / 1000;
  const poses = new Float32Array([seconds, 1, 0, 0, Math.sin(seconds / 2), 0, Math.cos(seconds / 2)]);
  const head = { channel: 0, flags: 0, version: 1, phase, timeS: phase * DURATION, error: 0, durationS: DURATION };
  return { dueMs, head, count: 1, poses };
}

interface Rig {
  buffer: JitterBuffer;
  /** A message arrives with this lateness. */
  arrive(dueMs: number, lateMs: number, phase?: number, x?: number): void;
  /** Displayed x of the figure. */
  x(nowMs: number): number;
}

function rig(): Rig {
  const lateness = new Lateness();
  const buffer = new JitterBuffer(lateness);
  const out = new Float32Array(7);
  buffer.reset(1);
  return {
    buffer,
    arrive(dueMs, lateMs, phase, x) {
      lateness.add(dueMs + lateMs, dueMs);
      const frame = frameAt(dueMs, phase);
      if (x !== undefined) frame.poses[0] = x;
      buffer.push(frame);
    },
    x(nowMs) {
      expect(buffer.sample(nowMs, out)).not.toBeNull();
      expect(Math.hypot(...out.subarray(3))).toBeCloseTo(1, 5);
      return out[0] as number;
    },
  };
}

/** Frames with random lateness and loss, in order. */
const arrivals = fc.array(
  fc.record({ late: fc.double({ min: 0, max: 90, noNaN: true }), lost: fc.nat(9).map((die) => die === 0) }),
  { minLength: 120, maxLength: 240 },
);

test("displayed time is monotone under any network jitter", () => {
  fc.assert(
    fc.property(arrivals, (frames) => {
      const { arrive, x, buffer } = rig();
      const events = frames.map(({ late, lost }, k) => ({ due: k * STEP, at: k * STEP + late, lost }));
      for (let k = 1; k < events.length; k++)
        (events[k] as { at: number }).at = Math.max(
          (events[k] as { at: number }).at,
          (events[k - 1] as { at: number }).at,
        );
      let before = Number.NEGATIVE_INFINITY;
      let next = 0;
      for (let now = 200; now < frames.length * STEP; now += STEP) {
        for (; next < events.length && (events[next] as { at: number }).at <= now; next++) {
          const { due, at, lost } = events[next] as (typeof events)[number];
          if (!lost) arrive(due, at - due);
        }
        if (buffer.length === 0) continue;
        const shown = x(now);
        expect(shown).toBeGreaterThanOrEqual(before - 1e-6);
        expect(shown).toBeLessThanOrEqual(now / 1000 + EXTRAPOLATE_MS / 1000);
        before = shown;
      }
      expect(buffer.length).toBeLessThanOrEqual(FRAMES_KEPT);
      expect(buffer.delayMs).toBeGreaterThanOrEqual(STEP);
      expect(buffer.delayMs).toBeLessThanOrEqual(STEP + MOST_LATE_MS);
    }),
    { numRuns: 40 },
  );
});

test("linear motion is interpolated exactly", () => {
  const { arrive, x } = rig();
  for (let k = 0; k < 20; k++) arrive(k * STEP, 5);
  for (const now of [200, 203, 207.5, 211, 216]) expect(x(now)).toBeCloseTo((now - 5 - STEP) / 1000, 4);
});

test("the delay follows the lateness continuously", () => {
  const { arrive, x, buffer } = rig();
  const coming: { due: number; at: number }[] = [];
  let k = 0;
  let before = Number.NaN;
  /** Display delay after a number of frames with a given lateness, s. */
  const run = (frames: number, late: (k: number) => number) => {
    let now = 0;
    for (const end = k + frames; k < end; k++) {
      const at = Math.max(k * STEP + late(k), coming.at(-1)?.at ?? 0); // a connection keeps the order
      coming.push({ due: k * STEP, at });
      now = k * STEP + 6;
      while (coming[0] && coming[0].at <= now) {
        const { due, at } = coming.shift() as (typeof coming)[number];
        arrive(due, at - due);
      }
      const shown = x(now);
      if (k > 10) {
        expect(shown - before).toBeGreaterThan((0.75 * STEP) / 1000);
        expect(shown - before).toBeLessThan((1.15 * STEP) / 1000);
      }
      before = shown;
    }
    return now / 1000 - before;
  };
  const calm = run(120, () => 5);
  const rough = run(400, (each) => (each % 5 === 0 ? 60 : 5));
  expect(rough - calm).toBeGreaterThan(0.04);
  expect(run(1200, () => 5) - calm).toBeLessThan(0.01);
  expect(buffer.delayMs).toBeCloseTo(STEP, 3);
});

test("without new frames the motion is extrapolated and then stops", () => {
  const { arrive, x } = rig();
  for (let k = 0; k <= 60; k++) arrive(k * STEP, 0);
  expect(x(1000 + STEP + 50)).toBeCloseTo(1.05, 3);
  expect(x(1000 + STEP + 400)).toBeCloseTo(1 + EXTRAPOLATE_MS / 1000, 3);
  expect(x(5000)).toBeCloseTo(1 + EXTRAPOLATE_MS / 1000, 3);
});

test("displayed time continues between a reconnection and its first message", () => {
  const lateness = new Lateness();
  const buffer = new JitterBuffer(lateness);
  buffer.reset(1);
  for (let k = 0; k <= 60; k++) {
    lateness.add(k * STEP + 5, k * STEP);
    buffer.push(frameAt(k * STEP));
  }
  const before = buffer.shownMs(1000);
  lateness.clear();
  expect(buffer.shownMs(1010)).toBeCloseTo(before + 10, 6);
});

test("a jump of half a metre is cross-faded, also in centimetres", () => {
  const shown = [1, 100].map((unit) => {
    const { buffer, arrive } = rig();
    const out = new Float32Array(7);
    buffer.unitsPerMetre = unit;
    for (let k = 0; k < 60; k++) arrive(k * STEP, 0, k < 30 ? 0.1 : 0.8, k < 30 ? 0 : 0.5 * unit);
    for (const dueMs of [29 * STEP, 30 * STEP + FADE_MS / 2]) buffer.sample(dueMs + STEP, out);
    return (out[0] as number) / unit;
  });
  for (const x of shown) expect(x).toBeCloseTo(0.25, 5);
});

test("a discontinuity is cross-faded in 160 ms from its due time", () => {
  const { buffer, arrive } = rig();
  const out = new Float32Array(7);
  for (let k = 0; k < 30; k++) arrive(k * STEP, 0, 0.1);
  for (let k = 30; k < 60; k++) arrive(k * STEP, 0, 0.8);
  const due = 30 * STEP;
  const at = (shown: number) => buffer.sample(shown + STEP, out);
  expect(at(due - 1)?.head.phase).toBeCloseTo(0.1, 5);
  expect(at(due + 1)?.head.phase).toBeCloseTo(0.8, 5);
  expect(out[0]).toBeCloseTo((due - STEP) / 1000, 3); // start of the cross-fade
  expect((at(due + FADE_MS / 2)?.head.flags ?? 0) & 2).toBe(2);
  expect((at(due + FADE_MS + 1)?.head.flags ?? 0) & 2).toBe(0);
  expect(out[0]).toBeCloseTo((due + FADE_MS + 1) / 1000, 4);
});

test("the seam of a loop is not a discontinuity", () => {
  const { buffer, arrive } = rig();
  const out = new Float32Array(7);
  const phases: number[] = [];
  for (let k = 0; k < 180; k++) {
    arrive(k * STEP, 0);
    const sample = buffer.sample(k * STEP + 3, out);
    expect((sample?.head.flags ?? 0) & 2).toBe(0);
    phases.push(sample?.head.phase ?? -1);
  }
  expect(Math.min(...phases)).toBeGreaterThanOrEqual(0);
  expect(Math.max(...phases)).toBeLessThan(1);
  expect(Math.max(...phases)).toBeGreaterThan(0.98);
});

test("reset discards all frames", () => {
  const { buffer, arrive } = rig();
  for (let k = 0; k < 30; k++) arrive(5000 + k * STEP, 0);
  buffer.reset(1);
  const out = new Float32Array(7);
  expect(buffer.sample(6000, out)).toBeNull();
  arrive(100, 0); // another server's clock may be behind
  expect(buffer.sample(6000, out)?.count).toBe(1);
  expect(out[0]).toBeCloseTo(0.1, 5);
});

test("repeated and late frames are discarded", () => {
  const { buffer } = rig();
  expect([buffer.push(frameAt(10)), buffer.push(frameAt(10)), buffer.push(frameAt(5))]).toEqual([true, false, false]);
  expect(buffer.length).toBe(1);
});

test("a new character starts at its first frame, and a silent one keeps its pose", () => {
  const { buffer } = rig();
  const two = (dueMs: number, x: number): Frame => ({
    ...frameAt(dueMs),
    count: 2,
    poses: new Float32Array([0, 1, 0, 0, 0, 0, 1, x, 1, 0, 0, 0, 0, 1]),
  });
  buffer.push(frameAt(0));
  buffer.push(two(STEP, 5));
  expect([...buffer.blank(2)]).toEqual([...two(0, 5).poses]);
  expect(buffer.blank(3).length).toBe(21);
  const out = new Float32Array(14);
  expect(buffer.sample(10_000, out)?.count).toBe(1); // without lateness the oldest frame is displayed
});
