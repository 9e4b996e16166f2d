/** Vectors and unit quaternions (x, y, z, w) as tuples. */

export type V = readonly [number, number, number];
export type Q = readonly [number, number, number, number];

export const STILL: Q = [0, 0, 0, 1];

export const add = (a: V, b: V): V => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a: V, b: V): V => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (a: V, s: number): V => [s * a[0], s * a[1], s * a[2]];
export const dot = (a: V, b: V): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: V): number => Math.hypot(a[0], a[1], a[2]);
export const cross = (a: V, b: V): V => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const unit = (a: V): V => times(a, 1 / Math.max(length(a), 1e-12));
/** The part of a vector across another, which is unit. */
export const level = (a: V, up: V): V => sub(a, times(up, dot(a, up)));

export const multiply = (a: Q, b: Q): Q => [
  a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
  a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
  a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
  a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
];
export const inverse = (a: Q): Q => [-a[0], -a[1], -a[2], a[3]];

export function rotate(q: Q, v: V): V {
  const t = times(cross([q[0], q[1], q[2]], v), 2);
  return add(add(v, times(t, q[3])), cross([q[0], q[1], q[2]], t));
}

export function normal(x: number, y: number, z: number, w: number): Q {
  const size = Math.hypot(x, y, z, w);
  return size < 1e-12 ? STILL : [x / size, y / size, z / size, w / size];
}

/** Rotation about a unit axis, radians. */
export function about(axis: V, angle: number): Q {
  const s = Math.sin(angle / 2);
  return [s * axis[0], s * axis[1], s * axis[2], Math.cos(angle / 2)];
}

/** The smallest rotation from one direction to another; the identity where one has no length. Half a turn is about +Z. */
export function arc(a: V, b: V): Q {
  const size = length(a) * length(b);
  if (size < 1e-12) return STILL;
  const [x, y, z] = cross(a, b);
  const w = size + dot(a, b);
  if (w < 1e-9 * size) {
    const across = level([0, 0, 1], unit(a));
    return normal(...(length(across) > 1e-3 ? across : level([0, 1, 0], unit(a))), 0);
  }
  return normal(x, y, z, w);
}

/** A share of the way from one rotation to another, by the shorter way. */
export function between(a: Q, b: Q, share: number): Q {
  const sign = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -share : share;
  const u = 1 - share;
  return normal(u * a[0] + sign * b[0], u * a[1] + sign * b[1], u * a[2] + sign * b[2], u * a[3] + sign * b[3]);
}

/** Unit quaternion of a rotation with these columns. */
export function ofAxes(x: V, y: V, z: V): Q {
  const trace = x[0] + y[1] + z[2];
  if (trace > -0.9) return normal(y[2] - z[1], z[0] - x[2], x[1] - y[0], 1 + trace);
  if (x[0] >= y[1] && x[0] >= z[2]) return normal(1 + x[0] - y[1] - z[2], y[0] + x[1], z[0] + x[2], y[2] - z[1]);
  if (y[1] >= z[2]) return normal(y[0] + x[1], 1 - x[0] + y[1] - z[2], z[1] + y[2], z[0] - x[2]);
  return normal(z[0] + x[2], z[1] + y[2], 1 - x[0] - y[1] + z[2], x[1] - y[0]);
}
