/** Vectors for per-verb computation; per-frame code uses typed arrays. */
export type V3 = readonly [number, number, number];

export const ZERO: V3 = [0, 0, 0];

export const add = (a: V3, b: V3): V3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a: V3, b: V3): V3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: V3, by: number): V3 => [a[0] * by, a[1] * by, a[2] * by];
export const dot = (a: V3, b: V3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: V3): number => Math.hypot(a[0], a[1], a[2]);
export const lerp = (a: V3, b: V3, t: number): V3 => add(a, scale(sub(b, a), t));

export const cross = (a: V3, b: V3): V3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Unit vector along `a`; `instead` for a zero vector. */
export function unit(a: V3, instead: V3 = [0, 1, 0]): V3 {
  const size = length(a);
  return size > 1e-9 ? scale(a, 1 / size) : instead;
}

/** Unit vector nearest to `direction` that is perpendicular to the unit vector `axis`. */
export function square(direction: V3, axis: V3): V3 {
  const rest = sub(direction, scale(axis, dot(direction, axis)));
  if (length(rest) > 1e-3) return unit(rest);
  return square(Math.abs(axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], axis);
}

export function mean(points: readonly V3[]): V3 {
  return scale(points.reduce(add, ZERO), 1 / Math.max(points.length, 1));
}

/** Centre and half-sizes of the bounding box. */
export function box(points: readonly V3[]): { centre: V3; half: V3 } {
  const low = [0, 1, 2].map((k) => Math.min(...points.map((p) => p[k] as number))) as unknown as V3;
  const high = [0, 1, 2].map((k) => Math.max(...points.map((p) => p[k] as number))) as unknown as V3;
  return { centre: scale(add(low, high), 0.5), half: scale(sub(high, low), 0.5) };
}
