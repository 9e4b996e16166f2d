/**
 * Charts: coordinates in which an adverb space is convex, and the clamp to the domain; as `verbs/kernels/chart.py`.
 *
 * A chart maps D adverbs to D normalised coordinates; three of them may bend.
 */

type Vector = ArrayLike<number>;

/** Chart numbers by position, as artifacts store them. */
export const CHARTS = ["identity", "cylinder", "planar"];
const CYLINDER = 1;
const PLANAR = 2;
const TURN = 2 * Math.PI;

/** Up to this gauge (1 is the hull's surface) a point is left where it is; no clamped point lies beyond the second. */
const FREE_GAUGE = 1.08;
const LAST_GAUGE = 1.25;

export interface Chart {
  kind: number;
  /** Adverbs that bend. */
  axes: Vector;
  /** Cylinder: axis x, z, cut (rad), unrolling radius; planar: first the radians per unit of the direction. */
  bend: Vector;
  /** Normalised coordinates are (bent adverbs − shift) · scale. */
  shift: Vector;
  scale: Vector;
}

/** The hull {u : facets · (u − middle) ≤ 1} in a chart; facets are F × D. */
export interface Domain {
  chart: Chart;
  facets: Vector;
  middle: Vector;
  /** Order of the smooth maximum over facets. */
  sharpness: number;
}

/** Normalised chart coordinates of adverbs. */
export function toChart({ kind, axes, bend, shift, scale }: Chart, adverbs: Vector, out: Float64Array): void {
  for (let a = 0; a < out.length; a++) out[a] = adverbs[a] as number;
  const [i, j, m] = [axes[0] as number, axes[1] as number, axes[2] as number];
  if (kind === CYLINDER) {
    const x = (adverbs[i] as number) - (bend[0] as number);
    const z = (adverbs[m] as number) - (bend[1] as number);
    out[i] = (bend[3] as number) * positive(Math.atan2(x, z) - (bend[2] as number), TURN);
    out[m] = Math.sqrt(x * x + z * z);
  } else if (kind === PLANAR) {
    const distance = adverbs[i] as number;
    const direction = (adverbs[j] as number) * (bend[0] || 1);
    out[i] = distance * Math.sin(direction);
    out[j] = distance * Math.cos(direction);
  }
  for (let a = 0; a < out.length; a++) out[a] = ((out[a] as number) - (shift[a] as number)) * (scale[a] as number);
}

/** Adverbs of normalised chart coordinates: the inverse of `toChart`. */
export function fromChart({ kind, axes, bend, shift, scale }: Chart, point: Vector, out: Float64Array): void {
  for (let a = 0; a < out.length; a++) out[a] = (point[a] as number) / (scale[a] as number) + (shift[a] as number);
  const [i, j, m] = [axes[0] as number, axes[1] as number, axes[2] as number];
  if (kind === CYLINDER) {
    const angle = (out[i] as number) / (bend[3] as number) + (bend[2] as number);
    const radius = out[m] as number;
    out[i] = (bend[0] as number) + radius * Math.sin(angle);
    out[m] = (bend[1] as number) + radius * Math.cos(angle);
  } else if (kind === PLANAR) {
    const x = out[i] as number;
    const z = out[j] as number;
    out[i] = Math.sqrt(x * x + z * z);
    out[j] = x !== 0 || z !== 0 ? Math.atan2(x, z) / (bend[0] || 1) : 0;
  }
}

/** Smooth gauge of a point: 1 on the hull's surface. */
function gauge(point: Vector, { facets, middle, sharpness }: Domain): number {
  const dims = middle.length;
  const rows = facets.length / dims;
  const values = new Float64Array(rows);
  let top = 0;
  for (let f = 0; f < rows; f++) {
    let value = 0;
    for (let a = 0; a < dims; a++)
      value += (facets[f * dims + a] as number) * ((point[a] as number) - (middle[a] as number));
    values[f] = value;
    top = Math.max(top, value);
  }
  if (top <= 0) return 0;
  let total = 0;
  for (const value of values) if (value > 0) total += (value / top) ** sharpness;
  return top * total ** (1 / sharpness);
}

/**
 * Adverbs moved back to the domain's surroundings, written to `out`; returns whether that changed them.
 * The identity up to gauge 1.08, then a hyperbolic tangent that never passes 1.25.
 */
export function clamp(domain: Domain, adverbs: Vector, out: Float64Array): boolean {
  const point = new Float64Array(out.length);
  toChart(domain.chart, adverbs, point);
  for (let a = 0; a < out.length; a++) out[a] = adverbs[a] as number;
  const value = gauge(point, domain);
  if (value <= FREE_GAUGE) return false;
  const span = LAST_GAUGE - FREE_GAUGE;
  const shrink = (FREE_GAUGE + span * Math.tanh((value - FREE_GAUGE) / span)) / value;
  for (let a = 0; a < out.length; a++) {
    const middle = domain.middle[a] as number;
    point[a] = middle + ((point[a] as number) - middle) * shrink;
  }
  fromChart(domain.chart, point, out);
  return true;
}

/** Remainder with the sign of the divisor. */
export function positive(value: number, divisor: number): number {
  const rest = value % divisor;
  return rest < 0 ? rest + divisor : rest;
}
