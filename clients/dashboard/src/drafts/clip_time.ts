/**
 * Seconds of a clip at phases of canonical time: monotone cubic through (phase, keytime), as `verbs/kernels/timewarp.py`.
 *
 * Source: F. N. Fritsch and J. Butland, "A method for constructing local monotone piecewise cubic interpolants", 1984.
 */

/** Slope at an end: parabola through three points, limited so that the curve stays monotone. */
function endSlope(near: number, far: number, nearSecant: number, farSecant: number): number {
  const slope = ((2 * near + far) * nearSecant - near * farSecant) / (near + far);
  if (slope * nearSecant <= 0) return 0;
  if (nearSecant * farSecant <= 0 && Math.abs(slope) > 3 * Math.abs(nearSecant)) return 3 * nearSecant;
  return slope;
}

/** Weighted harmonic mean of the secants on both sides. */
function innerSlope(left: number, right: number, leftSecant: number, rightSecant: number): number {
  if (leftSecant * rightSecant <= 0) return 0;
  const [a, b] = [left + 2 * right, right + 2 * left];
  return (a + b) / (b / rightSecant + a / leftSecant);
}

export class ClipTime {
  readonly #phases: readonly number[];
  readonly #keytimes: readonly number[];
  readonly #slopes: readonly number[];

  /** @param phases rising from 0 to 1; @param keytimes rising, s, as many */
  constructor(phases: readonly number[], keytimes: readonly number[], looping: boolean) {
    [this.#phases, this.#keytimes] = [phases, keytimes];
    const widths = phases.slice(1).map((phase, k) => phase - (phases[k] as number));
    const secants = widths.map((width, k) => ((keytimes[k + 1] as number) - (keytimes[k] as number)) / width);
    this.#slopes = slopesOf(widths, secants, looping);
  }

  /** Seconds at a phase from 0 to 1. */
  at(phase: number): number {
    const [phases, keytimes] = [this.#phases, this.#keytimes];
    let s = 0;
    while (s < phases.length - 2 && phase >= (phases[s + 1] as number)) s++;
    const width = (phases[s + 1] as number) - (phases[s] as number);
    const u = (phase - (phases[s] as number)) / width;
    const v = 1 - u;
    const [y0, y1] = [keytimes[s] as number, keytimes[s + 1] as number];
    const [m0, m1] = [this.#slopes[s] as number, this.#slopes[s + 1] as number];
    return v * v * ((1 + 2 * u) * y0 + u * width * m0) + u * u * ((3 - 2 * u) * y1 - v * width * m1);
  }

  /** Phase at a time, by bisection; times outside the keytimes give 0 or 1. */
  phaseAt(timeS: number): number {
    let [low, high] = [0, 1];
    for (let k = 0; k < 40; k++) {
      const middle = (low + high) / 2;
      if (this.at(middle) < timeS) low = middle;
      else high = middle;
    }
    return (low + high) / 2;
  }
}

function slopesOf(widths: readonly number[], secants: readonly number[], looping: boolean): number[] {
  const last = widths.length;
  const [w, d] = [(k: number) => widths[k] as number, (k: number) => secants[k] as number];
  if (last === 1) return [d(0), d(0)];
  const inner = widths.slice(1).map((_, k) => innerSlope(w(k), w(k + 1), d(k), d(k + 1)));
  if (looping) {
    const seam = innerSlope(w(last - 1), w(0), d(last - 1), d(0));
    return [seam, ...inner, seam];
  }
  const first = endSlope(w(0), w(1), d(0), d(1));
  return [first, ...inner, endSlope(w(last - 1), w(last - 2), d(last - 1), d(last - 2))];
}
