import type { Skeleton } from "../types";

/** Skeleton as flat arrays: parents before children, offsets 3 per joint (m). */
export interface Rig {
  readonly joints: number;
  readonly parents: Int32Array;
  readonly offsets: Float32Array;
}

export function rigOf(skeleton: Skeleton): Rig {
  return {
    joints: skeleton.names.length,
    parents: Int32Array.from(skeleton.parents),
    offsets: Float32Array.from(skeleton.offsets.flat()),
  };
}

/** Numbers per character in `Picture.poses`. */
export const poseLength = (rig: Rig): number => 3 + 4 * rig.joints;

/** Quaternion product a ∘ b of x, y, z, w at the given indices. */
function multiply(a: Float32Array, i: number, b: Float32Array, j: number, out: Float32Array, k: number): void {
  const ax = a[i] as number;
  const ay = a[i + 1] as number;
  const az = a[i + 2] as number;
  const aw = a[i + 3] as number;
  const bx = b[j] as number;
  const by = b[j + 1] as number;
  const bz = b[j + 2] as number;
  const bw = b[j + 3] as number;
  out[k] = aw * bx + ax * bw + ay * bz - az * by;
  out[k + 1] = aw * by - ax * bz + ay * bw + az * bx;
  out[k + 2] = aw * bz + ax * by - ay * bx + az * bw;
  out[k + 3] = aw * bw - ax * bx - ay * by - az * bz;
}

/** Position of a child: parent position `p` plus offset `o` rotated by the parent rotation `q`. */
function attach(rotations: Float32Array, q: number, positions: Float32Array, p: number, rig: Rig, o: number): void {
  const x = rotations[q] as number;
  const y = rotations[q + 1] as number;
  const z = rotations[q + 2] as number;
  const w = rotations[q + 3] as number;
  const vx = rig.offsets[o] as number;
  const vy = rig.offsets[o + 1] as number;
  const vz = rig.offsets[o + 2] as number;
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  positions[o] = (positions[p] as number) + vx + w * tx + y * tz - z * ty;
  positions[o + 1] = (positions[p + 1] as number) + vy + w * ty + z * tx - x * tz;
  positions[o + 2] = (positions[p + 2] as number) + vz + w * tz + x * ty - y * tx;
}

/**
 * Forward kinematics of one pose: global positions and rotations of all joints.
 *
 * @param poses root x, y, z and local x, y, z, w per joint, from index `at` on
 * @param positions written: 3 per joint, m
 * @param rotations written: 4 per joint, global
 */
export function solve(
  rig: Rig,
  poses: Float32Array,
  at: number,
  positions: Float32Array,
  rotations: Float32Array,
): void {
  for (let j = 0; j < rig.joints; j++) {
    const parent = rig.parents[j] as number;
    const local = at + 3 + 4 * j;
    if (parent < 0) {
      for (let k = 0; k < 3; k++) positions[3 * j + k] = poses[at + k] as number;
      for (let k = 0; k < 4; k++) rotations[4 * j + k] = poses[local + k] as number;
    } else {
      multiply(rotations, 4 * parent, poses, local, rotations, 4 * j);
      attach(rotations, 4 * parent, positions, 3 * parent, rig, 3 * j);
    }
  }
}

/** Write joint `j` as a column-major 4×4 matrix at `out[at]`, moved by `shift`. */
export function writeMatrix(
  positions: Float32Array,
  rotations: Float32Array,
  j: number,
  shift: Float32Array,
  out: Float32Array,
  at: number,
): void {
  const x = rotations[4 * j] as number;
  const y = rotations[4 * j + 1] as number;
  const z = rotations[4 * j + 2] as number;
  const w = rotations[4 * j + 3] as number;
  out[at] = 1 - 2 * (y * y + z * z);
  out[at + 1] = 2 * (x * y + z * w);
  out[at + 2] = 2 * (x * z - y * w);
  out[at + 3] = 0;
  out[at + 4] = 2 * (x * y - z * w);
  out[at + 5] = 1 - 2 * (x * x + z * z);
  out[at + 6] = 2 * (y * z + x * w);
  out[at + 7] = 0;
  out[at + 8] = 2 * (x * z + y * w);
  out[at + 9] = 2 * (y * z - x * w);
  out[at + 10] = 1 - 2 * (x * x + y * y);
  out[at + 11] = 0;
  for (let k = 0; k < 3; k++) out[at + 12 + k] = (positions[3 * j + k] as number) + (shift[k] as number);
  out[at + 15] = 1;
}

/** Heading of a rotation about +Y, rad: angle of its forward axis from +Z toward +X. */
export function yawOf(rotations: Float32Array, at: number): number {
  const x = rotations[at] as number;
  const y = rotations[at + 1] as number;
  const z = rotations[at + 2] as number;
  const w = rotations[at + 3] as number;
  return Math.atan2(2 * (x * z + y * w), 1 - 2 * (x * x + y * y));
}
