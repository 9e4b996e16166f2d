/** Sloped ground under a character that climbs. */

import { Quaternion, Vector3 } from "three";
import type { Incline } from "../types";

/** Smoothing rate of the drawn plane, 1/s. */
const RATE = 6;
/** A character that is farther from its ground than this was moved, m. */
const FAR_M = 0.3;
const LONGEST_STEP_S = 0.1;
const WHOLE_TURN = 2 * Math.PI;

export interface Slope {
  /** Point of the ground below the root, m. */
  readonly x: number;
  readonly y: number;
  readonly z: number;
  /** Direction in which the ground rises, rad from +Z toward +X; and rise per metre. */
  readonly course: number;
  readonly gradient: number;
}

/** Height of the ground at a place, m; 0 without a slope. */
export function groundHeight(slope: Slope | null, x: number, z: number): number {
  if (!slope) return 0;
  const along = (x - slope.x) * Math.sin(slope.course) + (z - slope.z) * Math.cos(slope.course);
  return slope.y + slope.gradient * along;
}

/** Height of the root above the ground and direction of travel minus heading at a phase. */
export function inclineAt({ heights, turns }: Incline, phase: number): { height: number; turn: number } {
  const at = Math.min(Math.max(phase, 0), 1) * (heights.length - 1);
  const k = Math.min(Math.floor(at), heights.length - 2);
  const between = (values: Float32Array) =>
    (values[k] as number) + (at - k) * ((values[k + 1] as number) - (values[k] as number));
  return { height: between(heights), turn: between(turns) };
}

/** The slope a moment later, under a root at `root` (m) with the heading `yaw` (rad). */
export function followSlope(
  before: Slope | null,
  incline: Incline,
  phase: number,
  root: Float32Array,
  yaw: number,
  delta_s: number,
): Slope {
  const { height, turn } = inclineAt(incline, phase);
  const [x, z] = [root[0] as number, root[2] as number];
  const now = { x, y: (root[1] as number) - height, z, course: yaw + turn, gradient: incline.gradient };
  const expected = groundHeight(before, x, z);
  if (!before || Math.abs(now.y - expected) > FAR_M) return now;
  const share = 1 - Math.exp(-RATE * delta_s);
  const away = now.course - before.course;
  return {
    ...now,
    y: expected + share * (now.y - expected),
    course: before.course + share * (away - WHOLE_TURN * Math.round(away / WHOLE_TURN)),
    gradient: before.gradient + share * (now.gradient - before.gradient),
  };
}

/** Rotation of level ground to the slope, in `out`. */
function tiltOf(slope: Slope | null, out: Quaternion): Quaternion {
  if (!slope) return out.identity();
  const across = new Vector3(Math.cos(slope.course), 0, -Math.sin(slope.course));
  return out.setFromAxisAngle(across, -Math.atan(slope.gradient));
}

/** Ground under one character: level until an incline is known. */
export class SlopedGround {
  slope: Slope | null = null;
  /** Rotation of level ground to the slope. */
  readonly tilt = new Quaternion();
  #incline: Incline | null = null;
  #at = 0;

  /** Incline of the current goal; null: level ground. */
  set(incline: Incline | null): void {
    this.#incline = incline;
    if (!incline) this.slope = null;
  }

  follow(phase: number, root: Float32Array, yaw: number, now_s: number): void {
    const delta_s = Math.min(now_s - this.#at, LONGEST_STEP_S);
    this.#at = now_s;
    if (this.#incline) this.slope = followSlope(this.slope, this.#incline, phase, root, yaw, delta_s);
    tiltOf(this.slope, this.tilt);
  }

  height(x: number, z: number): number {
    return groundHeight(this.slope, x, z);
  }
}
