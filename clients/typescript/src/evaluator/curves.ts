/** Blended B-spline curves; as `verbs/kernels/pose.py` and `crowd_pose.py`. */

import type { StoredVerb } from "./verb_file.js";

/** Length under which a sum of quaternions has lost its direction. */
const SHORTEST = 0.3;

/**
 * Pose of weights at a phase in 0 to 1: root, then local unit quaternions, written to `out` (3 + 4·J).
 *
 * @param sums scratch (4 + 4·J)
 */
export function blendCurves(
  verb: StoredVerb,
  weights: ArrayLike<number>,
  phase: number,
  sums: Float64Array,
  out: Float32Array | Float64Array,
): void {
  sum(verb, weights, phase, sums);
  for (let a = 0; a < 3; a++) out[a] = sums[a] as number;
  for (let q = 4; q < sums.length; q += 4) {
    if (verb.vectors) rotateReference(verb.references, q - 4, sums, q);
    else normalise(verb.references, q - 4, sums, q);
    for (let a = 0; a < 4; a++) out[q - 1 + a] = sums[q + a] as number;
  }
}

/** Sum of the rows around a phase, four of them at a time. */
function sum(verb: StoredVerb, weights: ArrayLike<number>, phase: number, sums: Float64Array): void {
  const { curves, intervals } = verb;
  const [count, width] = [weights.length, sums.length];
  const x = phase * intervals;
  const k = Math.min(Math.max(Math.floor(x), 0), intervals - 1);
  const u = x - k;
  const v = 1 - u;
  const tap0 = (v * v * v) / 6;
  const tap1 = 2 / 3 - u * u + 0.5 * u * u * u;
  const tap2 = 2 / 3 - v * v + 0.5 * v * v * v;
  const tap3 = (u * u * u) / 6;
  const stride = count * width;
  sums.fill(0);
  for (let i = 0; i < count; i++) {
    const weight = weights[i] as number;
    if (weight === 0) continue;
    const [a, b, c, d] = [tap0 * weight, tap1 * weight, tap2 * weight, tap3 * weight];
    let at = (k * count + i) * width;
    for (let column = 0; column < width; column++, at++)
      sums[column] =
        (sums[column] as number) +
        a * (curves[at] as number) +
        b * (curves[at + stride] as number) +
        c * (curves[at + 2 * stride] as number) +
        d * (curves[at + 3 * stride] as number);
  }
}

/** A sum that is too short becomes the reference of its joint. */
function normalise(references: Float64Array, r: number, q: Float64Array, at: number): void {
  const [x, y, z, w] = [q[at] as number, q[at + 1] as number, q[at + 2] as number, q[at + 3] as number];
  const squared = x * x + y * y + z * z + w * w;
  if (!(squared >= SHORTEST * SHORTEST)) {
    for (let a = 0; a < 4; a++) q[at + a] = references[r + a] as number;
    return;
  }
  const scale = 1 / Math.sqrt(squared);
  q[at] = scale * x;
  q[at + 1] = scale * y;
  q[at + 2] = scale * z;
  q[at + 3] = scale * w;
}

/** Reference · exp(rotation vector). */
function rotateReference(references: Float64Array, r: number, q: Float64Array, at: number): void {
  const [vx, vy, vz] = [q[at] as number, q[at + 1] as number, q[at + 2] as number];
  const angle = Math.sqrt(vx * vx + vy * vy + vz * vz);
  const scale = angle > 1e-9 ? Math.sin(0.5 * angle) / angle : 0.5;
  const [x, y, z, w] = [scale * vx, scale * vy, scale * vz, Math.cos(0.5 * angle)];
  const a = references[r] as number;
  const b = references[r + 1] as number;
  const c = references[r + 2] as number;
  const d = references[r + 3] as number;
  q[at] = d * x + a * w + b * z - c * y;
  q[at + 1] = d * y - a * z + b * w + c * x;
  q[at + 2] = d * z + a * y - b * x + c * w;
  q[at + 3] = d * w - a * x - b * y - c * z;
}
