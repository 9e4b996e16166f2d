import { multiply, type Numbers, rotate } from "./quaternion.js";

/** Joints of a skeleton: parents before children, offsets in the parent's frame (m). */
export interface Skeleton {
  readonly names: readonly string[];
  /** -1 for the root. */
  readonly parents: readonly number[];
  readonly offsets: readonly (readonly number[])[];
}

/** Skeleton as flat arrays: parents before children, offsets 3 per joint (m). */
export interface Rig {
  readonly joints: number;
  readonly parents: Int32Array;
  readonly offsets: Float64Array;
}

export function rigOf(skeleton: Skeleton): Rig {
  return {
    joints: skeleton.names.length,
    parents: Int32Array.from(skeleton.parents),
    offsets: Float64Array.from(skeleton.offsets.flat()),
  };
}

/**
 * Forward kinematics of one pose: global positions and rotations of all joints.
 *
 * @param poses root x, y, z and local x, y, z, w per joint, from index `at` on
 * @param positions written: 3 per joint, m
 * @param rotations written: 4 per joint, global
 */
export function solve(rig: Rig, poses: Readonly<Numbers>, at: number, positions: Numbers, rotations: Numbers): void {
  for (let j = 0; j < rig.joints; j++) {
    const parent = rig.parents[j] as number;
    const local = at + 3 + 4 * j;
    if (parent < 0) {
      for (let k = 0; k < 3; k++) positions[3 * j + k] = poses[at + k] as number;
      for (let k = 0; k < 4; k++) rotations[4 * j + k] = poses[local + k] as number;
    } else {
      multiply(rotations, 4 * j, rotations, 4 * parent, poses, local);
      rotate(positions, 3 * j, rotations, 4 * parent, rig.offsets, 3 * j);
      for (let k = 0; k < 3; k++)
        positions[3 * j + k] = (positions[3 * j + k] as number) + (positions[3 * parent + k] as number);
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
