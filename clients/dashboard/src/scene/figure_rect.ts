import { type PerspectiveCamera, Vector3 } from "three";
import type { Drawn } from "../types";

export const NOTHING_DRAWN: Drawn = {
  frames: 0,
  effector: null,
  goal: null,
  figure: null,
  contacts: 0,
  slide: null,
  detail: 0,
  handle: null,
};

/** Left, top, right and bottom in canvas pixels. */
export type Rect = readonly [left: number, top: number, right: number, bottom: number];

const point = new Vector3();

/** Bounding rectangle of projected positions (3 numbers each); null if one of them is behind the camera. */
export function figureRect(
  positions: Float32Array,
  camera: PerspectiveCamera,
  wide: number,
  high: number,
): Rect | null {
  let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
  for (let k = 0; k < positions.length; k += 3) {
    point.fromArray(positions, k).project(camera);
    if (!(Math.abs(point.z) <= 1)) return null;
    const [x, y] = [(point.x * 0.5 + 0.5) * wide, (0.5 - point.y * 0.5) * high];
    [left, top, right, bottom] = [Math.min(left, x), Math.min(top, y), Math.max(right, x), Math.max(bottom, y)];
  }
  return [left, top, right, bottom];
}

/** Whether no part of a figure is in the picture. */
export function isOffscreen(rect: Rect | null, wide: number, high: number): boolean {
  return rect === null || rect[2] < 0 || rect[0] > wide || rect[3] < 0 || rect[1] > high;
}
