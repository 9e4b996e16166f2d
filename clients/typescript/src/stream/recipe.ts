/**
 * One character whose weights are streamed, by the encoding `weights` and `send: "changes"`.
 *
 * Its phase advances here, by the time-warp of its weights, and its poses are evaluated here. A root that travels
 * starts at the origin. Records correct the phase; feet are not planted.
 */

import type { Evaluator } from "../evaluator/evaluator.js";
import type { TimeWarp } from "../evaluator/timewarp.js";
import { type Place, START } from "../evaluator/travel.js";
import { slerp } from "../math/quaternion.js";
import { FLAGS, type RecordHead } from "../wire/decode.js";

/** Records closer than this are interpolated, ms; after a longer time without one the weights were constant. */
const CLOSE_MS = 120;
/** A larger phase correction is cross-faded, and the duration of the cross-fade, ms. */
const JUMP = 0.005;
const FADE_MS = 200;
/** Records that wait to be displayed. */
const MOST_WAITING = 120;

export interface RecipeRecord {
  /** Due time on the server's clock, ms. */
  dueMs: number;
  head: RecordHead;
  weights: Float32Array;
  /** Seconds of motion per second: 0 where it is paused, negative backwards. */
  rate: number;
  loop: boolean;
}

/** The verb of a record, or null until it is there. */
export type EvaluatorOf = (head: RecordHead) => Evaluator | null;

export class Recipe {
  /** The displayed record first. */
  private readonly records: RecipeRecord[] = [];
  private clock: TimeWarp | null = null;
  private evaluator: Evaluator | null = null;
  /** Displayed phase and place; NaN before the first pose. */
  private phase = Number.NaN;
  private place: Place = { ...START };
  private blended = new Float32Array(0);
  private latest = new Float32Array(0);
  private left = new Float32Array(0);
  private enteredMs = Number.NEGATIVE_INFINITY;

  /** Head of the displayed record, with phase and seconds of the displayed instant; null before the first pose. */
  shown: RecordHead | null = null;

  get ready(): boolean {
    return this.records.length > 0;
  }

  take(record: RecipeRecord): void {
    const last = this.records.at(-1);
    if (last && record.dueMs <= last.dueMs) return;
    this.records.push(record);
    if (this.records.length > MOST_WAITING) this.advance(1);
  }

  /** Write the pose at an instant on the server's clock to `out`; returns whether there is one. */
  write(dueMs: number, evaluatorOf: EvaluatorOf, out: Float32Array): boolean {
    while (this.records.length > 1 && (this.records[1] as RecipeRecord).dueMs <= dueMs && this.advance(1, evaluatorOf));
    const record = this.records[0];
    if (!record) return false;
    this.evaluator ??= evaluatorOf(record.head);
    if (!this.evaluator || !fits(this.evaluator, record, out)) return this.repeat(out);
    const next = this.records[1];
    const close = next && next.dueMs - record.dueMs <= CLOSE_MS && next.weights.length === record.weights.length;
    if (close) this.between(record, next, (dueMs - record.dueMs) / (next.dueMs - record.dueMs), out);
    else this.after(record, Math.max(dueMs - record.dueMs, 0) / 1000, out);
    this.fade(dueMs, out);
    return true;
  }

  /** Forget everything, for another session. */
  reset(): void {
    this.records.length = 0;
    this.clock = this.evaluator = this.shown = null;
    this.phase = Number.NaN;
    this.place = { ...START };
  }

  /** Display the next record from now on, unless its verb is missing. */
  private advance(by: number, evaluatorOf?: EvaluatorOf): boolean {
    const [before, record] = [this.records[0] as RecipeRecord, this.records[by] as RecipeRecord];
    const other = !isSameVerb(before.head, record.head);
    if (other && evaluatorOf && !evaluatorOf(record.head)) return false;
    const begins = record.head.flags & ~before.head.flags & (FLAGS.inTransition | FLAGS.newVersion);
    if (other || begins) this.cut(record.dueMs);
    else if (this.clock && Math.abs(turned(record.head.phase - this.reached(before, record.dueMs))) > JUMP)
      this.cut(record.dueMs);
    if (other) this.evaluator = null;
    this.records.splice(0, by);
    this.clock = null;
    return true;
  }

  /** Phase to which a record leads at an instant. */
  private reached(record: RecipeRecord, dueMs: number): number {
    return this.instant(record, (dueMs - record.dueMs) / 1000).phase;
  }

  /** Two records that follow each other: the goal moves. */
  private between(a: RecipeRecord, b: RecipeRecord, share: number, out: Float32Array): void {
    const u = Math.min(Math.max(share, 0), 1);
    if (this.blended.length !== a.weights.length) this.blended = new Float32Array(a.weights.length);
    for (let i = 0; i < a.weights.length; i++)
      this.blended[i] = (1 - u) * (a.weights[i] as number) + u * (b.weights[i] as number);
    const way = b.head.phase - a.head.phase;
    const { looping } = (this.evaluator as Evaluator).verb;
    const phase = a.head.phase + u * (looping ? turned(way) : way);
    const timeS = a.head.timeS + u * (Math.abs(way) > 0.5 ? 0 : b.head.timeS - a.head.timeS);
    this.pose(u < 0.5 ? a : b, this.blended, looping ? phase - Math.floor(phase) : phase, timeS, a.rate, out);
  }

  /** Some seconds after a record. */
  private after(record: RecipeRecord, seconds: number, out: Float32Array): void {
    const { phase, timeS, restarts } = this.instant(record, seconds);
    if (restarts && Math.abs(phase - this.phase) > 0.5) this.cut(record.dueMs + 1000 * seconds);
    this.pose(record, record.weights, phase, timeS, record.rate, out);
  }

  private instant(record: RecipeRecord, seconds: number): { phase: number; timeS: number; restarts: boolean } {
    const { head, rate } = record;
    const gone = rate * seconds;
    if (gone === 0 || !this.evaluator) return { phase: head.phase, timeS: head.timeS, restarts: false };
    this.clock ??= this.evaluator.clock(record.weights);
    const { durationS } = this.clock;
    let timeS = head.timeS + gone;
    if (record.loop) timeS -= Math.floor(timeS / durationS) * durationS;
    timeS = Math.min(Math.max(timeS, 0), durationS);
    return { phase: this.clock.phaseAt(timeS), timeS, restarts: record.loop && !this.evaluator.verb.looping };
  }

  private pose(
    record: RecipeRecord,
    weights: ArrayLike<number>,
    phase: number,
    timeS: number,
    rate: number,
    out: Float32Array,
  ): void {
    const evaluator = this.evaluator as Evaluator;
    const way = evaluator.verb.looping ? stepOf(this.phase, phase, rate) : phase - this.phase;
    if (!Number.isNaN(this.phase)) evaluator.travel(weights, this.phase, this.phase + way, this.place);
    this.phase = phase;
    evaluator.write(weights, phase, this.place, out);
    this.shown = { ...record.head, phase, timeS };
  }

  /** A pose follows that does not continue the displayed one. */
  private cut(dueMs: number): void {
    if (!this.shown) return;
    [this.left, this.latest] = [this.latest, this.left];
    this.enteredMs = dueMs;
    this.phase = Number.NaN;
  }

  /** Cross-fade local rotations and height from the pose before a cut; keep the result for the next one. */
  private fade(dueMs: number, out: Float32Array): void {
    const share = Math.max(dueMs - this.enteredMs, 0) / FADE_MS;
    const { left } = this;
    if (share < 1 && left.length === out.length) {
      const u = share * share * (3 - 2 * share);
      if (this.shown) this.shown.flags |= FLAGS.inTransition;
      out[1] = (1 - u) * (left[1] as number) + u * (out[1] as number);
      for (let k = 3; k < out.length; k += 4) slerp(out, k, left, k, out, k, u);
    }
    if (this.latest.length !== out.length) this.latest = new Float32Array(out.length);
    this.latest.set(out);
  }

  /** The pose before, while a new version of the verb is loaded. */
  private repeat(out: Float32Array): boolean {
    if (this.latest.length !== out.length || !this.shown) return false;
    out.set(this.latest);
    return true;
  }
}

function isSameVerb(a: RecordHead, b: RecordHead): boolean {
  return a.verb === b.verb && a.version === b.version;
}

function fits(evaluator: Evaluator, record: RecipeRecord, out: Float32Array): boolean {
  return evaluator.verb.examples.length === record.weights.length && evaluator.poseLength === out.length;
}

/** Way from a phase of a cycle to another, in the direction of play; small corrections may go the other way. */
function stepOf(from: number, to: number, rate: number): number {
  const way = turned(to - from);
  if (Math.abs(way) < 2 * JUMP || rate === 0) return way;
  const forward = to - from - Math.floor(to - from);
  return rate > 0 ? forward : forward - 1;
}

/** Phase difference modulo 1, in −0.5 to 0.5. */
function turned(difference: number): number {
  return difference - Math.round(difference);
}
