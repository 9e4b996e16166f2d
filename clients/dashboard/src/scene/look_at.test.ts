import { rigOf, solve } from "adverb-client";
import { expect, test } from "vitest";
import type { Skeleton } from "../types";
import { anatomyOf } from "./anatomy";
import { LookAt } from "./look_at";
import type { V3 } from "./vec";

const SKELETON = {
  names: ["Hips", "Chest", "Neck", "Head", "LeftArm", "RightArm"],
  parents: [-1, 0, 1, 2, 1, 1],
  offsets: [
    [0, 0, 0],
    [0, 0.4, 0],
    [0, 0.2, 0],
    [0, 0.1, 0],
    [0.2, 0.1, 0],
    [-0.2, 0.1, 0],
  ],
  tips: [{ parent: 3, offset: [0, 0.2, 0] }],
} as unknown as Skeleton;

/** Heading and elevation of the face, deg, after two seconds. */
function look(target: V3 | null, seconds = 2) {
  const [rig, head] = [rigOf(SKELETON), new LookAt(anatomyOf(SKELETON))];
  head.resize(1);
  const positions = new Float32Array(3 * rig.joints);
  const rotations = new Float32Array(4 * rig.joints);
  const pose = new Float32Array(3 + 4 * rig.joints);
  pose[1] = 1;
  for (let j = 0; j < rig.joints; j++) pose[3 + 4 * j + 3] = 1;
  for (let k = 0; k < 60 * seconds; k++) {
    solve(rig, pose, 0, positions, rotations);
    head.turn(0, positions, rotations, target, 1 / 60);
  }
  const [x, y, z, w] = rotations.subarray(12, 16) as unknown as [number, number, number, number];
  const face = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)] as const;
  const degrees = 180 / Math.PI;
  return { side: Math.atan2(face[0], face[2]) * degrees, up: Math.asin(face[1]) * degrees, positions, rotations };
}

test("the head turns toward a target within its range", () => {
  const { side, up } = look([2, 2.2, 2]);
  expect(side).toBeCloseTo(45, 0);
  expect(up).toBeGreaterThan(8);
  expect(up).toBeLessThan(13);
});

test("the turn is bounded, and a target behind is ignored", () => {
  expect(look([5, 1.7, -0.5]).side).toBeCloseTo((1 * 180) / Math.PI, 0);
  expect(look([0, 9, 1]).up).toBeCloseTo((0.35 * 180) / Math.PI, 0);
  expect(look([0.5, 1.7, -5]).side).toBeCloseTo(0, 5);
  expect(look(null).side).toBeCloseTo(0, 5);
});

test("the turn is gradual", () => {
  expect(Math.abs(look([2, 1.7, 2], 1 / 30).side)).toBeLessThan(10);
});

test("only neck and head turn, and lengths stay", () => {
  const { positions, rotations } = look([2, 2.2, 2]);
  expect([...rotations.subarray(16, 20)]).toEqual([0, 0, 0, 1]);
  const away = (a: number, b: number) =>
    Math.hypot(...[0, 1, 2].map((i) => (positions[3 * a + i] as number) - (positions[3 * b + i] as number)));
  expect(away(2, 3)).toBeCloseTo(0.1, 5);
  expect(away(1, 2)).toBeCloseTo(0.2, 5);
});
