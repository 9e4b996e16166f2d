/** Unit quaternions x, y, z, w inside flat arrays: functions read and write at offsets without allocation. */

export type Numbers = Float32Array | Float64Array | number[];

/** Cosine above which slerp uses linear interpolation. */
const NEARLY_ONE = 0.9995;

/** out = a ∘ b: first b, then a. */
export function multiply(out: Numbers, o: number, a: Readonly<Numbers>, i: number, b: Readonly<Numbers>, j: number) {
  const ax = a[i] as number;
  const ay = a[i + 1] as number;
  const az = a[i + 2] as number;
  const aw = a[i + 3] as number;
  const bx = b[j] as number;
  const by = b[j + 1] as number;
  const bz = b[j + 2] as number;
  const bw = b[j + 3] as number;
  out[o] = aw * bx + ax * bw + ay * bz - az * by;
  out[o + 1] = aw * by + ay * bw + az * bx - ax * bz;
  out[o + 2] = aw * bz + az * bw + ax * by - ay * bx;
  out[o + 3] = aw * bw - ax * bx - ay * by - az * bz;
}

/** out = the vector v rotated by q. */
export function rotate(out: Numbers, o: number, q: Readonly<Numbers>, i: number, v: Readonly<Numbers>, j: number) {
  const x = q[i] as number;
  const y = q[i + 1] as number;
  const z = q[i + 2] as number;
  const w = q[i + 3] as number;
  const vx = v[j] as number;
  const vy = v[j + 1] as number;
  const vz = v[j + 2] as number;
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  out[o] = vx + w * tx + y * tz - z * ty;
  out[o + 1] = vy + w * ty + z * tx - x * tz;
  out[o + 2] = vz + w * tz + x * ty - y * tx;
}

/** Normalise in place; a zero quaternion becomes the identity. */
export function normalize(q: Numbers, i: number) {
  const x = q[i] as number;
  const y = q[i + 1] as number;
  const z = q[i + 2] as number;
  const w = q[i + 3] as number;
  const length = Math.sqrt(x * x + y * y + z * z + w * w);
  if (!(length > 0)) {
    q[i] = q[i + 1] = q[i + 2] = 0;
    q[i + 3] = 1;
    return;
  }
  for (let k = 0; k < 4; k++) q[i + k] = (q[i + k] as number) / length;
}

/**
 * Spherical interpolation at `share` from a to b along the shorter arc; a share above 1 extrapolates.
 * The arrays may be the same.
 */
export function slerp(
  out: Numbers,
  o: number,
  a: Readonly<Numbers>,
  i: number,
  b: Readonly<Numbers>,
  j: number,
  share: number,
) {
  const ax = a[i] as number;
  const ay = a[i + 1] as number;
  const az = a[i + 2] as number;
  const aw = a[i + 3] as number;
  const bx = b[j] as number;
  const by = b[j + 1] as number;
  const bz = b[j + 2] as number;
  const bw = b[j + 3] as number;
  const dot = ax * bx + ay * by + az * bz + aw * bw;
  const near = Math.abs(dot);
  let from = 1 - share;
  let to = share;
  if (near < NEARLY_ONE) {
    const angle = Math.acos(near);
    const sine = Math.sin(angle);
    from = Math.sin(from * angle) / sine;
    to = Math.sin(to * angle) / sine;
  }
  if (dot < 0) to = -to;
  out[o] = from * ax + to * bx;
  out[o + 1] = from * ay + to * by;
  out[o + 2] = from * az + to * bz;
  out[o + 3] = from * aw + to * bw;
  normalize(out, o);
}

/** Heading of a rotation about +Y, rad: angle of its forward axis from +Z toward +X. */
export function heading(q: Readonly<Numbers>, i: number): number {
  const x = q[i] as number;
  const y = q[i + 1] as number;
  const z = q[i + 2] as number;
  const w = q[i + 3] as number;
  return Math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y));
}
