/** Keytimes ↔ canonical time by a monotone cubic (Fritsch and Butland 1984); as `verbs/kernels/timewarp.py`. */

type Vector = Float64Array;

const NEWTON_END = 1e-7;

/** Seconds and phases of one blend. */
export class TimeWarp {
  /** Seconds of the keytimes, from 0. */
  readonly keytimes: Vector;
  private readonly tangents: Vector;

  /**
   * @param weights of N examples
   * @param logLengths logarithms of the examples' segment lengths, N × (M − 1)
   */
  constructor(
    private readonly phases: Vector,
    logLengths: Vector,
    looping: boolean,
    weights: ArrayLike<number>,
  ) {
    const segments = phases.length - 1;
    this.keytimes = new Float64Array(phases.length);
    this.tangents = new Float64Array(phases.length);
    for (let m = 0; m < segments; m++) {
      let total = 0;
      for (let i = 0; i < weights.length; i++)
        total += (weights[i] as number) * (logLengths[i * segments + m] as number);
      this.keytimes[m + 1] = (this.keytimes[m] as number) + Math.exp(total);
    }
    slopes(phases, this.keytimes, looping, this.tangents);
  }

  get durationS(): number {
    return this.keytimes[this.keytimes.length - 1] as number;
  }

  /** Seconds at a phase, 0 to 1. */
  timeAt(phase: number): number {
    const { phases, keytimes, tangents } = this;
    const s = segment(phases, phase);
    const width = (phases[s + 1] as number) - (phases[s] as number);
    const u = (phase - (phases[s] as number)) / width;
    const v = 1 - u;
    return (
      v * v * ((1 + 2 * u) * (keytimes[s] as number) + u * width * (tangents[s] as number)) +
      u * u * ((3 - 2 * u) * (keytimes[s + 1] as number) - v * width * (tangents[s + 1] as number))
    );
  }

  /** Phase at seconds: the inverse of `timeAt`, by Newton steps that bisection keeps in bounds. */
  phaseAt(timeS: number): number {
    const { phases, keytimes, tangents } = this;
    const s = segment(keytimes, timeS);
    const [y0, y1] = [keytimes[s] as number, keytimes[s + 1] as number];
    const width = (phases[s + 1] as number) - (phases[s] as number);
    if (timeS <= y0) return phases[s] as number;
    if (timeS >= y1) return phases[s + 1] as number;
    const [m0, m1] = [width * (tangents[s] as number), width * (tangents[s + 1] as number)];
    let [low, high, u] = [0, 1, (timeS - y0) / (y1 - y0)];
    for (let k = 0; k < 60; k++) {
      const v = 1 - u;
      const miss = v * v * ((1 + 2 * u) * y0 + u * m0) + u * u * ((3 - 2 * u) * y1 - v * m1) - timeS;
      if (miss > 0) high = u;
      else low = u;
      const rate = 6 * u * v * (y1 - y0) + v * (1 - 3 * u) * m0 + u * (3 * u - 2) * m1;
      let after = rate > 0 ? u - miss / rate : 0.5 * (low + high);
      if (!(after >= low && after <= high)) after = 0.5 * (low + high);
      const moved = Math.abs(after - u);
      u = after;
      if (moved < 1e-15 || (moved < NEWTON_END && rate > 0.1 * (y1 - y0))) break;
    }
    return (phases[s] as number) + u * width;
  }
}

/** Logarithms of segment lengths, N × (M − 1), of keytimes N × M. */
export function logLengthsOf(keytimes: Vector, marks: number): Vector {
  const count = keytimes.length / marks;
  const out = new Float64Array(count * (marks - 1));
  for (let i = 0; i < count; i++)
    for (let m = 0; m < marks - 1; m++)
      out[i * (marks - 1) + m] = Math.log(
        (keytimes[i * marks + m + 1] as number) - (keytimes[i * marks + m] as number),
      );
  return out;
}

/** Index of the segment that contains a value; the first or last one where it lies outside. */
function segment(knots: Vector, at: number): number {
  let s = 0;
  while (s < knots.length - 2 && at >= (knots[s + 1] as number)) s++;
  return s;
}

function endSlope(near: number, far: number, nearSecant: number, farSecant: number): number {
  const slope = ((2 * near + far) * nearSecant - near * farSecant) / (near + far);
  if (slope * nearSecant <= 0) return 0;
  if (nearSecant * farSecant <= 0 && Math.abs(slope) > 3 * Math.abs(nearSecant)) return 3 * nearSecant;
  return slope;
}

function innerSlope(left: number, right: number, leftSecant: number, rightSecant: number): number {
  if (leftSecant * rightSecant <= 0) return 0;
  const [a, b] = [2 * right + left, right + 2 * left];
  return (a + b) / (a / leftSecant + b / rightSecant);
}

/** Slopes of the monotone cubic through values at rising knots; `periodic` makes those at both ends equal. */
function slopes(knots: Vector, values: Vector, periodic: boolean, out: Vector): void {
  const last = knots.length - 1;
  const width = (m: number) => (knots[m + 1] as number) - (knots[m] as number);
  const secant = (m: number) => ((values[m + 1] as number) - (values[m] as number)) / width(m);
  if (last === 1) {
    out.fill(secant(0));
    return;
  }
  for (let m = 1; m < last; m++) out[m] = innerSlope(width(m - 1), width(m), secant(m - 1), secant(m));
  if (periodic) {
    out[0] = out[last] = innerSlope(width(last - 1), width(0), secant(last - 1), secant(0));
    return;
  }
  out[0] = endSlope(width(0), width(1), secant(0), secant(1));
  out[last] = endSlope(width(last - 1), width(last - 2), secant(last - 1), secant(last - 2));
}
