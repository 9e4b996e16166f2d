import type { Skeleton } from "../types";

/** A skeleton as flat arrays: parents before children, offsets 3 per joint (m). */
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

/** Numbers of one character in `Picture.poses`. */
export const poseLength = (rig: Rig): number => 3 + 4 * rig.joints;

/** Turn `b` by `a` and write the product, all quaternions x, y, z, w at an index of their array. */
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

/** Write place `p` of the parent plus its turn `q` of the offset at `o`. */
function attach(turns: Float32Array, q: number, places: Float32Array, p: number, rig: Rig, o: number): void {
  const x = turns[q] as number;
  const y = turns[q + 1] as number;
  const z = turns[q + 2] as number;
  const w = turns[q + 3] as number;
  const vx = rig.offsets[o] as number;
  const vy = rig.offsets[o + 1] as number;
  const vz = rig.offsets[o + 2] as number;
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  places[o] = (places[p] as number) + vx + w * tx + y * tz - z * ty;
  places[o + 1] = (places[p + 1] as number) + vy + w * ty + z * tx - x * tz;
  places[o + 2] = (places[p + 2] as number) + vz + w * tz + x * ty - y * tx;
}

/**
 * Forward kinematics of one pose: where every joint is, and how it is turned.
 *
 * @param poses root x, y, z and local x, y, z, w per joint, from index `at` on
 * @param places written: 3 per joint, m
 * @param turns written: 4 per joint, global
 */
export function solve(rig: Rig, poses: Float32Array, at: number, places: Float32Array, turns: Float32Array): void {
  for (let j = 0; j < rig.joints; j++) {
    const parent = rig.parents[j] as number;
    const local = at + 3 + 4 * j;
    if (parent < 0) {
      for (let k = 0; k < 3; k++) places[3 * j + k] = poses[at + k] as number;
      for (let k = 0; k < 4; k++) turns[4 * j + k] = poses[local + k] as number;
    } else {
      multiply(turns, 4 * parent, poses, local, turns, 4 * j);
      attach(turns, 4 * parent, places, 3 * parent, rig, 3 * j);
    }
  }
}

/** Write joint `j` as a column-major 4×4 matrix at `out[at]`, moved by `shift`. */
export function writeMatrix(
  places: Float32Array,
  turns: Float32Array,
  j: number,
  shift: Float32Array,
  out: Float32Array,
  at: number,
): void {
  const x = turns[4 * j] as number;
  const y = turns[4 * j + 1] as number;
  const z = turns[4 * j + 2] as number;
  const w = turns[4 * j + 3] as number;
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
  for (let k = 0; k < 3; k++) out[at + 12 + k] = (places[3 * j + k] as number) + (shift[k] as number);
  out[at + 15] = 1;
}

/** Heading of a turn about +Y, rad: the angle of its forward axis from +Z toward +X. */
export function headingOf(turns: Float32Array, at: number): number {
  const x = turns[at] as number;
  const y = turns[at + 1] as number;
  const z = turns[at + 2] as number;
  const w = turns[at + 3] as number;
  return Math.atan2(2 * (x * z + y * w), 1 - 2 * (x * x + y * y));
}
