/** Weights of a cardinal basis; as `verbs/kernels/radial_basis.py`. */

import { toChart } from "../math/chart.js";
import type { Basis } from "./verb_file.js";

const BSPLINE = 0;
const MULTIQUADRIC = 1;
const BIHARMONIC = 2;
const THIN_PLATE = 3;
const CUBIC = 4;

/** Radial function of a number at scaled distance r ≥ 0. */
function phi(kernel: number, r: number): number {
  switch (kernel) {
    case BSPLINE:
      if (r >= 2) return 0;
      return r >= 1 ? (2 - r) ** 3 / 6 : 2 / 3 - r * r + 0.5 * r * r * r;
    case MULTIQUADRIC:
      return -Math.sqrt(r * r + 1);
    case BIHARMONIC:
      return -r;
    case THIN_PLATE:
      return r > 0 ? r * r * Math.log(r) : 0;
    case CUBIC:
      return r * r * r;
    default: {
      const half = 0.5 * r; // Wendland C²
      return half < 1 ? (1 - half) ** 4 * (4 * half + 1) : 0;
    }
  }
}

/** Add `share` times a row of coefficients. */
function add(out: Float64Array, share: number, coefficients: Float64Array, row: number): void {
  const start = row * out.length;
  for (let i = 0; i < out.length; i++) out[i] = (out[i] as number) + share * (coefficients[start + i] as number);
}

/** Weights of adverbs inside the domain, written to `out` (N). */
export function weightsAt(basis: Basis, adverbs: ArrayLike<number>, out: Float64Array): void {
  const { centers, radii, radial, poly, degree, kernel } = basis;
  const dims = adverbs.length;
  const point = new Float64Array(dims);
  toChart(basis.chart, adverbs, point);
  out.fill(0);
  let row = 0;
  if (degree >= 1) for (let a = 0; a < dims; a++) add(out, point[a] as number, poly, row++);
  if (degree >= 2)
    for (let a = 0; a < dims; a++)
      for (let b = a; b < dims; b++) add(out, (point[a] as number) * (point[b] as number), poly, row++);
  add(out, 1, poly, row);
  for (let c = 0; c < radii.length; c++) {
    let squared = 0;
    for (let a = 0; a < dims; a++) squared += ((point[a] as number) - (centers[c * dims + a] as number)) ** 2;
    const value = phi(kernel, Math.sqrt(squared) / (radii[c] as number));
    if (value !== 0) add(out, value, radial, c);
  }
}
