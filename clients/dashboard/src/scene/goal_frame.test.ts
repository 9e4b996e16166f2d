import { expect, test } from "vitest";
import { crowdOffset } from "./figures";
import { GoalFrame } from "./goal_frame";

const ROWS = { side: [1, 0, 0], back: [0, 0, -1] } as const;

test("characters of a crowd have distinct positions beside and behind the first", () => {
  const at = new Float32Array(3);
  for (const count of [1, 2, 7, 200, 1000]) {
    const positions = new Set<string>();
    for (let k = 0; k < count; k++) {
      crowdOffset(k, count, ROWS, at);
      if (k === 0) expect(Array.from(at).map(Math.abs)).toEqual([0, 0, 0]);
      expect(at[2]).toBeLessThanOrEqual(0);
      positions.add(at.join());
    }
    expect(positions.size).toBe(count);
  }
});

/** A root at x, z that faces `heading`. */
function pose(x: number, z: number, heading: number): [Float32Array, Float32Array] {
  return [Float32Array.from([x, 1, z]), Float32Array.from([0, Math.sin(heading / 2), 0, Math.cos(heading / 2)])];
}

test("a looped jump starts at the previous landing", () => {
  const from = new GoalFrame();
  from.updateJump(0, ...pose(0, 0, 0.1));
  from.updateJump(0.5, ...pose(0, 0.6, 0.3));
  from.updateJump(0.99, ...pose(0.2, 1.2, 0.6));
  expect([from.x, from.z, from.heading]).toEqual([0, 0, 0]);
  from.updateJump(0.01, ...pose(0.21, 1.21, 0.6));
  expect([from.x, from.z, from.heading]).toEqual([expect.closeTo(0.2), expect.closeTo(1.2), expect.closeTo(0.5)]);
});

test("a rewound jump starts at its own start", () => {
  const from = new GoalFrame();
  from.updateJump(0, ...pose(0, 0, 0));
  from.updateJump(1, ...pose(0, 1.5, 0));
  from.updateJump(0, ...pose(0, 0, 0));
  expect([from.x, from.z, from.heading]).toEqual([0, 0, 0]);
});

test("a stride starts at the root; its heading follows the hips along the shorter arc", () => {
  const from = new GoalFrame();
  from.updateStride(...pose(1, 2, 3), 0.02);
  expect([from.x, from.z, from.heading]).toEqual([1, 2, expect.closeTo(3)]);
  expect(from.updateStride(...pose(1, 2.1, -3), 0.02)).toBe(true);
  expect(from.heading).toBeGreaterThan(3);
  for (let k = 0; k < 400; k++) from.updateStride(...pose(1, 2.1, -3), 0.02);
  expect(from.heading).toBeCloseTo(2 * Math.PI - 3, 2);
});
