/** Roots that travel by steps in a turning frame; as `verbs/kernels/pose.py`. */

type Numbers = ArrayLike<number>;
/** Sideways, forward (m), turn (rad), rise (m). */
type Step = readonly [number, number, number, number];

/** Place of a root: x, z (m), heading (rad), height (m). */
export interface Place {
  x: number;
  z: number;
  heading: number;
  height: number;
}

export const START: Readonly<Place> = { x: 0, z: 0, heading: 0, height: 0 };

/** Walks a blend's steps. */
export class Walk {
  private readonly intervals: number;

  /** @param strides K × N × 4 */
  constructor(
    private readonly strides: Float64Array,
    private readonly weights: Numbers,
    private readonly looping: boolean,
  ) {
    this.intervals = strides.length / (4 * weights.length);
  }

  /** Place at an unwrapped phase (1.5 is the middle of the second cycle), from the origin. */
  placeAt(phase: number): Place {
    const place = { ...START };
    let start = 0;
    if (this.looping && phase >= 2) {
      start = Math.floor(phase);
      this.walkCycles(start, place);
    }
    this.walk(start, phase, place);
    return place;
  }

  /** Move a place from a phase to another, also backwards; unwrapped phases, of any cycle. */
  advance(from: number, to: number, place: Place): void {
    const shift = this.looping ? Math.floor(Math.min(from, to)) : 0;
    if (to >= from) return this.walk(from - shift, to - shift, place);
    const step = { ...START };
    this.walk(to - shift, from - shift, step);
    place.heading -= step.heading;
    const [cosine, sine] = [Math.cos(place.heading), Math.sin(place.heading)];
    place.x -= step.x * cosine + step.z * sine;
    place.z -= -step.x * sine + step.z * cosine;
    place.height -= step.height;
  }

  /** Whole cycles; all have the displacement of the first. */
  private walkCycles(cycles: number, place: Place): void {
    const once = { ...START };
    this.walk(0, 1, once);
    for (let k = 0; k < cycles; k++) {
      const [cosine, sine] = [Math.cos(place.heading), Math.sin(place.heading)];
      place.x += once.x * cosine + once.z * sine;
      place.z += -once.x * sine + once.z * cosine;
      place.heading += once.heading;
      place.height += once.height;
    }
  }

  private walk(start: number, end: number, place: Place): void {
    const { intervals, looping } = this;
    let at = start * intervals;
    const stop = end * intervals;
    if (at >= stop - 1e-12) return;
    let k = Math.floor(at + 1e-12);
    let step = this.step(k);
    let before = looping || k > 0 ? this.step(k - 1) : step;
    while (at < stop - 1e-12) {
      const upto = Math.min(k + 1, stop);
      const after = looping || k < intervals - 1 ? this.step(k + 1) : step;
      const [u, v] = [Math.min(Math.max(at - k, 0), 1), Math.min(Math.max(upto - k, 0), 1)];
      const part = (a: 0 | 1 | 2 | 3) =>
        covered(v, step[a], before[a], after[a]) - covered(u, step[a], before[a], after[a]);
      const [side, ahead, turn] = [part(0), part(1), part(2)];
      const middle = place.heading + 0.5 * turn;
      const [cosine, sine] = [Math.cos(middle), Math.sin(middle)];
      place.x += side * cosine + ahead * sine;
      place.z += ahead * cosine - side * sine;
      place.heading += turn;
      place.height += part(3);
      before = step;
      step = after;
      at = upto;
      k++;
    }
  }

  /** Blended step of an interval, which wraps around. */
  private step(k: number): Step {
    const { strides, weights, intervals } = this;
    const row = ((k % intervals) + intervals) % intervals;
    let [side, ahead, turn, rise] = [0, 0, 0, 0];
    for (let i = 0, at = 4 * row * weights.length; i < weights.length; i++, at += 4) {
      const weight = weights[i] as number;
      side += weight * (strides[at] as number);
      ahead += weight * (strides[at + 1] as number);
      turn += weight * (strides[at + 2] as number);
      rise += weight * (strides[at + 3] as number);
    }
    return [side, ahead, turn, rise];
  }
}

/** Part of a step covered at u in 0 to 1: a cubic whose ends share their neighbours' mean speed. */
function covered(u: number, step: number, before: number, after: number): number {
  const v = 1 - u;
  return u * u * (3 - 2 * u) * step + u * v * (v * 0.5 * (before + step) - u * 0.5 * (step + after));
}
