import { expect, test } from "vitest";
import type { Axes } from "./drive/steering";
import { separation, Walkers } from "./walkers";

const axis = (name: string, min: number, max: number) => ({ name, si: 1, min, max });
const AXES: Axes = { forward: axis("v", -0.7, 4), turn: axis("w", -1.6, 1.6), side: axis("s", -1, 1) };

/** Move characters by their goals for some seconds, the first stays; calls `look` after each step. */
function walk(places: Float32Array, seconds: number, look: () => void): Walkers {
  const walkers = new Walkers();
  const [count, step] = [places.length / 3, 1 / 30];
  for (let t = 0; t < seconds; t += step) {
    walkers.update(AXES, places, count, 1000 * t);
    for (const [i, { v: speed = 0, w: turn = 0 }] of walkers.goals.entries()) {
      const k = 3 * (i + 1);
      const heading = (places[k + 2] as number) + turn * step;
      places[k + 2] = heading;
      places[k] = (places[k] as number) + speed * step * Math.sin(heading);
      places[k + 1] = (places[k + 1] as number) + speed * step * Math.cos(heading);
    }
    look();
  }
  return walkers;
}

function nearest(places: Float32Array): number {
  let least = Number.POSITIVE_INFINITY;
  for (let a = 0; a < places.length; a += 3)
    for (let b = 0; b < a; b += 3) {
      const [dx, dz] = [0, 1].map((i) => (places[a + i] as number) - (places[b + i] as number)) as [number, number];
      least = Math.min(least, Math.hypot(dx, dz));
    }
  return least;
}

test("a walker ahead pushes to the side, one behind hardly", () => {
  const ahead = separation(Float32Array.of(0, 0, 0, 0, 1, 0), 0, [0, 1]);
  expect(Math.abs(ahead.x)).toBeGreaterThan(0.5);
  expect(ahead.free).toBeCloseTo(1);
  const behind = separation(Float32Array.of(0, 0, 0, 0, -1, 0), 0, [0, 1]);
  expect(Math.hypot(behind.x, behind.z)).toBeLessThan(0.01);
});

test("two walkers that meet pass each other", () => {
  const places = Float32Array.of(50, 50, 0, 0, -3, 0, 0, 3, Math.PI);
  let least = 9;
  walk(places, 8, () => {
    least = Math.min(least, nearest(places.subarray(3)));
  });
  expect(least).toBeGreaterThan(0.5);
});

test("a crowd keeps apart and in its area", () => {
  const places = new Float32Array(3 * 40);
  for (let k = 0; k < 40; k++) places.set([1.44 * (k % 8), -1.44 * Math.floor(k / 8), 2.4 * k], 3 * k);
  let [steps, close, far] = [0, 0, 0];
  const walkers = walk(places, 60, () => {
    steps++;
    if (nearest(places) < 0.4) close++;
    for (let k = 0; k < 40; k++)
      far = Math.max(far, Math.hypot((places[3 * k] as number) - 5, (places[3 * k + 1] as number) + 2.9));
  });
  expect(close / steps).toBeLessThan(0.02);
  expect(far).toBeLessThan(14);
  expect(new Set(walkers.goals.map(({ v }) => v?.toFixed(2))).size).toBeGreaterThan(10);
});
