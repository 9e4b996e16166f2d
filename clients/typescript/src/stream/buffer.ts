/**
 * Jitter buffer between arriving frames and displayed pictures.
 *
 * Frames are displayed after a delay of one frame interval, so that two frames surround the displayed instant, plus
 * the lateness of nearly all frames. Playback runs slightly faster or slower until the delay matches the measured
 * lateness. Without new frames the motion is extrapolated briefly and then stops. Discontinuities are cross-faded
 * in 160 ms.
 */

import { slerp } from "../math/quaternion.js";
import { FLAGS, poseLength, type RecordHead } from "../wire/decode.js";
import type { Lateness } from "./clock.js";

export const FRAMES_KEPT = 48;
/** Limits of the lateness allowance and of extrapolation, ms. */
export const MOST_LATE_MS = 250;
export const EXTRAPOLATE_MS = 100;
/** Duration of the cross-fade after a discontinuity, ms. */
export const FADE_MS = 160;
/** A root displacement beyond this (m) is not cross-faded. */
const FARTHEST = 1;
/** A larger playhead error is corrected at once, ms. */
const SNAP_MS = 500;
/** Relative slowdown and speed-up while the delay changes. */
const SLOWER = 0.2;
const FASTER = 0.1;
/** Frames further apart than this many intervals explain no larger phase step. */
const LONGEST_STEP = 3.5;
/** A phase step of this many times the expected one is a discontinuity. */
const JUMP = 6;
const LEAST_JUMP = 0.04;

/** All characters of a figure stream at one tick; the head is that of the first. */
export interface Frame {
  dueMs: number;
  head: RecordHead;
  /** Number of characters in `poses`. */
  count: number;
  poses: Float32Array;
}

export interface Sample {
  count: number;
  /** Head of the nearer frame, with interpolated phase and times. */
  head: RecordHead;
  /** Time since the last received frame, ms; 0 while interpolating. */
  beyondMs: number;
}

interface Kept extends Frame {
  /** Discontinuity: no interpolation from the previous frame. */
  cut: boolean;
}

export class JitterBuffer {
  /** Frame interval, ms. */
  intervalMs = 1000 / 60;
  /** Playback speed; faster phase steps are discontinuities. */
  speed = 1;
  /** Unit of root positions. */
  unitsPerMetre = 1;
  private frames: Kept[] = [];
  private spare: Float32Array[] = [];
  private joints = 0;
  private lagMs = Number.NaN;
  private sampledMs = Number.NEGATIVE_INFINITY;
  /** Last discontinuity, and the poses displayed before it. */
  private entered: Kept | null = null;
  private left = new Float32Array(0);
  private latest = new Float32Array(0);

  constructor(private readonly lateness: Lateness) {}

  get length(): number {
    return this.frames.length;
  }

  get last(): Readonly<Frame> | null {
    return this.frames.at(-1) ?? null;
  }

  /** Display delay relative to the earliest possible instant. */
  get delayMs(): number {
    const late = this.lateness.beyondGroundMs(0.98);
    return this.intervalMs + Math.min(Number.isNaN(late) ? 0 : late, MOST_LATE_MS);
  }

  /** Discard all frames, for another skeleton or another server clock. */
  reset(joints: number): void {
    for (const frame of this.frames) this.recycle(frame.poses);
    this.frames = [];
    this.joints = joints;
    this.lagMs = Number.NaN;
    this.sampledMs = Number.NEGATIVE_INFINITY;
    this.entered = null;
    this.left = this.latest = new Float32Array(0);
  }

  /** Pose array for a number of characters, initialised with the last poses. */
  blank(characters: number): Float32Array {
    const length = characters * poseLength(this.joints);
    const at = this.spare.findIndex((array) => array.length === length);
    const array = at < 0 ? new Float32Array(length) : (this.spare.splice(at, 1)[0] as Float32Array);
    const before = this.frames.at(-1)?.poses;
    if (before) array.set(before.length > length ? before.subarray(0, length) : before);
    return array;
  }

  /** Add a frame and take ownership of its array; older frames are discarded. */
  push(frame: Frame, reached = true): boolean {
    const before = this.frames.at(-1);
    if (before && frame.dueMs <= before.dueMs) {
      this.recycle(frame.poses);
      return false;
    }
    this.frames.push({ ...frame, cut: before !== undefined && (!reached || this.jumped(before, frame)) });
    if (this.frames.length > FRAMES_KEPT) this.recycle((this.frames.shift() as Kept).poses);
    return true;
  }

  /**
   * Poses at a local time, written to `out`; null before the first frame.
   * Displayed time is monotone.
   */
  sample(nowMs: number, out: Float32Array): Sample | null {
    if (this.frames.length === 0) return null;
    const shownMs = this.shownMs(nowMs);
    const sample = this.read(shownMs, out);
    const flags = this.fade(shownMs, sample.count * poseLength(this.joints), out) ? FLAGS.inTransition : 0;
    return { ...sample, head: { ...sample.head, flags: sample.head.flags | flags } };
  }

  private read(shownMs: number, out: Float32Array): Sample {
    let at = this.frames.length;
    while (at > 0 && (this.frames[at - 1] as Kept).dueMs > shownMs) at--;
    for (const frame of this.frames.slice(0, at)) if (frame.cut && frame !== this.entered) this.enter(frame);
    for (; at > 2; at--) this.recycle((this.frames.shift() as Kept).poses); // two earlier frames give the end velocity
    if (at === 0) return this.at(this.frames[0] as Kept, this.frames[0] as Kept, 0, 0, out);
    const a = this.frames[at - 1] as Kept;
    const b = this.frames[at];
    if (b && !b.cut) return this.at(a, b, (shownMs - a.dueMs) / (b.dueMs - a.dueMs), 0, out);
    if (b && b.dueMs - a.dueMs < LONGEST_STEP * this.intervalMs) return this.at(a, a, 0, 0, out);
    return this.past(this.frames[at - 2], a, shownMs - a.dueMs, out);
  }

  /**
   * Instant on the server's clock that is displayed at a local time; NaN before the first message.
   * Between a reconnection and its first message the delay stays as it was.
   */
  shownMs(nowMs: number): number {
    const measured = this.lateness.groundMs + this.delayMs;
    const target = Number.isNaN(measured) ? this.lagMs : measured;
    if (Number.isNaN(target)) return this.frames[0]?.dueMs ?? Number.NaN;
    const passed = nowMs - this.sampledMs;
    if (Number.isNaN(this.lagMs) || Math.abs(target - this.lagMs) > SNAP_MS) this.lagMs = target;
    else if (passed > 0) this.lagMs += Math.min(Math.max(target - this.lagMs, -FASTER * passed), SLOWER * passed);
    this.sampledMs = Math.max(nowMs, this.sampledMs);
    return this.sampledMs - this.lagMs;
  }

  /** Extrapolate past the last frame, or the last one before a discontinuity, for a short time. */
  private past(before: Kept | undefined, last: Kept, beyondMs: number, out: Float32Array): Sample {
    if (!before || last === this.entered || last.head.flags & FLAGS.last) return this.at(last, last, 0, beyondMs, out);
    const share = 1 + Math.min(beyondMs, EXTRAPOLATE_MS) / (last.dueMs - before.dueMs);
    return this.at(before, last, share, beyondMs, out);
  }

  /** Interpolate between two frames, or extrapolate if `share` exceeds 1. */
  private at(a: Kept, b: Kept, share: number, beyondMs: number, out: Float32Array): Sample {
    const stride = poseLength(this.joints);
    const near = share < 0.5 ? a : b;
    const count = Math.min(near.count, Math.floor(out.length / stride));
    const both = a === b ? 0 : Math.min(a.count, b.count, count);
    if (both > 0) this.blend(a.poses, b.poses, 0, both * stride, share, out);
    if (both < count) out.set(near.poses.subarray(both * stride, count * stride), both * stride);
    return { count, head: headBetween(a.head, b.head, share, near.head), beyondMs };
  }

  private enter(frame: Kept): void {
    frame.cut = false;
    this.entered = frame;
    [this.left, this.latest] = [this.latest, this.left];
  }

  /** Cross-fade after a discontinuity; returns whether it is still running. */
  private fade(shownMs: number, length: number, out: Float32Array): boolean {
    const share = this.entered ? (shownMs - this.entered.dueMs) / FADE_MS : 1;
    const under = share < 1;
    if (under) this.pass(Math.max(share, 0), Math.min(length, this.left.length), out);
    if (this.latest.length < length) this.latest = new Float32Array(length);
    this.latest.set(out.subarray(0, length));
    return under;
  }

  private pass(share: number, length: number, out: Float32Array): void {
    const stride = poseLength(this.joints);
    const eased = share * share * (3 - 2 * share);
    for (let start = 0; start < length; start += stride) {
      const target = out.slice(start, start + 3);
      this.blend(this.left, out, start, start + stride, eased, out);
      const far = Math.hypot(...target.map((value, k) => value - (this.left[start + k] as number)));
      if (far > FARTHEST * this.unitsPerMetre) out.set(target, start);
    }
  }

  private blend(a: Float32Array, b: Float32Array, from: number, to: number, share: number, out: Float32Array): void {
    const stride = poseLength(this.joints);
    for (let start = from; start < to; start += stride) {
      for (let k = start; k < start + 3; k++) out[k] = (1 - share) * (a[k] as number) + share * (b[k] as number);
      for (let k = start + 3; k < start + stride; k += 4) slerp(out, k, a, k, b, k, share);
    }
  }

  private jumped(before: Frame, frame: Frame): boolean {
    const { head } = frame;
    if (head.flags & (FLAGS.inTransition | FLAGS.newVersion) || before.head.flags & FLAGS.inTransition) return false;
    const seconds = Math.min(frame.dueMs - before.dueMs, LONGEST_STEP * this.intervalMs) / 1000;
    const explained = (seconds * Math.abs(this.speed)) / Math.max(head.durationS, 1e-3);
    return Math.abs(turned(head.phase - before.head.phase)) > Math.max(LEAST_JUMP, JUMP * explained);
  }

  private recycle(poses: Float32Array): void {
    if (this.spare.length < 4) this.spare.push(poses);
    else this.spare[0] = poses; // array sizes change with the crowd
  }
}

/** Phase difference modulo 1, in −0.5 to 0.5. */
function turned(difference: number): number {
  return difference - Math.round(difference);
}

function headBetween(a: RecordHead, b: RecordHead, share: number, near: RecordHead): RecordHead {
  if (a === b) return a;
  const seam = Math.abs(b.phase - a.phase) > 0.5;
  const phase = a.phase + share * (seam ? turned(b.phase - a.phase) : b.phase - a.phase);
  const timeS = seam ? near.timeS : a.timeS + share * (b.timeS - a.timeS);
  const known = share <= 1 && !Number.isNaN(a.error + b.error);
  return {
    ...near,
    phase: seam ? phase - Math.floor(phase) : Math.min(Math.max(phase, 0), 1),
    timeS: Math.min(Math.max(timeS, 0), Math.max(a.durationS, b.durationS)),
    error: known ? a.error + share * (b.error - a.error) : near.error,
    durationS: near.durationS,
  };
}
