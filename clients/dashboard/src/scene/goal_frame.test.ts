import { expect, test } from "vitest";
import { standing } from "./figures";
import { Carried } from "./goal_frame";

const ROWS = { side: [1, 0, 0], back: [0, 0, -1] } as const;

test("a crowd stands beside and behind its first character, nobody on another's place", () => {
  const at = new Float32Array(3);
  for (const count of [1, 2, 7, 200, 1000]) {
    const places = new Set<string>();
    for (let k = 0; k < count; k++) {
      standing(k, count, ROWS, at);
      if (k === 0) expect(Array.from(at).map(Math.abs)).toEqual([0, 0, 0]);
      expect(at[2]).toBeLessThanOrEqual(0);
      places.add(at.join());
    }
    expect(places.size).toBe(count);
  }
});

/** A root at x, z that faces `heading`. */
function pose(x: number, z: number, heading: number): [Float32Array, Float32Array] {
  return [Float32Array.from([x, 1, z]), Float32Array.from([0, Math.sin(heading / 2), 0, Math.cos(heading / 2)])];
}

test("a jump that starts over is counted from where the last one landed", () => {
  const from = new Carried();
  from.jumps(0, ...pose(0, 0, 0.1));
  from.jumps(0.5, ...pose(0, 0.6, 0.3));
  from.jumps(0.99, ...pose(0.2, 1.2, 0.6));
  expect([from.x, from.z, from.heading]).toEqual([0, 0, 0]);
  from.jumps(0.01, ...pose(0.21, 1.21, 0.6));
  expect([from.x, from.z, from.heading]).toEqual([expect.closeTo(0.2), expect.closeTo(1.2), expect.closeTo(0.5)]);
});

test("a jump that is wound back is counted from its own start again", () => {
  const from = new Carried();
  from.jumps(0, ...pose(0, 0, 0));
  from.jumps(1, ...pose(0, 1.5, 0));
  from.jumps(0, ...pose(0, 0, 0));
  expect([from.x, from.z, from.heading]).toEqual([0, 0, 0]);
});

test("a walk is counted from under the root; its heading runs after the hips the shorter way round", () => {
  const from = new Carried();
  from.strides(...pose(1, 2, 3), 0.02);
  expect([from.x, from.z, from.heading]).toEqual([1, 2, expect.closeTo(3)]);
  expect(from.strides(...pose(1, 2.1, -3), 0.02)).toBe(true);
  expect(from.heading).toBeGreaterThan(3);
  for (let k = 0; k < 400; k++) from.strides(...pose(1, 2.1, -3), 0.02);
  expect(from.heading).toBeCloseTo(2 * Math.PI - 3, 2);
});
