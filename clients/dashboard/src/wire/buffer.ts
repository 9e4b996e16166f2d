/**
 * The jitter buffer: frames come when they come, pictures are wanted when they are wanted.
 *
 * A frame is shown a little later than it was due: by the interval between two frames, so that there is one on either
 * side to go between, and by the lateness that nearly all frames keep to. Shown time runs slightly faster or slower
 * until the delay is what the measured lateness asks for. Where frames fail to come, motion goes on for a moment, then
 * holds. Where the motion was set elsewhere, the picture passes there in a sixth of a second.
 */

import type { Lateness } from "./clock";
import { FLAGS, poseLength, type RecordHead } from "./decode";
import { slerp } from "./quaternion";

export const FRAMES_KEPT = 48;
/** Longest allowance for lateness, and how long motion goes on past the last frame; ms. */
export const MOST_LATE_MS = 250;
export const EXTRAPOLATE_MS = 100;
/** How long the picture passes from a frame to one that was not reached from it. */
export const FADE_MS = 160;
/** A root that is set further off than this (m) goes there at once. */
const FARTHEST = 1;
/** A playhead that is further off than this jumps. */
const SNAP_MS = 500;
/** Shares by which shown time may run behind or ahead of real time while the delay changes. */
const SLOWER = 0.2;
const FASTER = 0.1;
/** Frames further apart than so many intervals tell nothing about the speed at the end. */
const LONGEST_STEP = 3.5;
/** A phase that goes this many times as far as time explains was set, not reached. */
const JUMP = 6;
const LEAST_JUMP = 0.04;

/** All characters of a side at one tick; the head is the first one's. */
export interface Frame {
  dueMs: number;
  head: RecordHead;
  /** How many characters `poses` holds. */
  count: number;
  poses: Float32Array;
}

export interface Sample {
  count: number;
  /** The head of the nearer frame, with phase and times of the instant that is shown. */
  head: RecordHead;
  /** How far the instant lies past the last frame that came, ms; 0 where frames are there. */
  beyondMs: number;
}

interface Kept extends Frame {
  /** Not reached from the frame before it: nothing lies between the two. */
  cut: boolean;
}

export class JitterBuffer {
  /** Between two frames. */
  intervalMs = 1000 / 60;
  /** Share of a second that the motion advances in a second; what is faster is a jump. */
  speed = 1;
  private frames: Kept[] = [];
  private spare: Float32Array[] = [];
  private joints = 0;
  private lagMs = Number.NaN;
  private sampledMs = Number.NEGATIVE_INFINITY;
  /** The last frame that was not reached, and the poses that were shown before it. */
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

  /** How much later than the earliest possible the picture should be shown. */
  get delayMs(): number {
    const late = this.lateness.beyondGroundMs(0.98);
    return this.intervalMs + Math.min(Number.isNaN(late) ? 0 : late, MOST_LATE_MS);
  }

  /** Forget everything: another skeleton, or another server with another clock. */
  reset(joints: number): void {
    for (const frame of this.frames) this.recycle(frame.poses);
    this.frames = [];
    this.joints = joints;
    this.lagMs = Number.NaN;
    this.sampledMs = Number.NEGATIVE_INFINITY;
    this.entered = null;
    this.left = this.latest = new Float32Array(0);
  }

  /** An array for so many characters, filled with what was there last: who sends nothing stands still. */
  blank(characters: number): Float32Array {
    const length = characters * poseLength(this.joints);
    const at = this.spare.findIndex((array) => array.length === length);
    const array = at < 0 ? new Float32Array(length) : (this.spare.splice(at, 1)[0] as Float32Array);
    const before = this.frames.at(-1)?.poses;
    if (before) array.set(before.length > length ? before.subarray(0, length) : before);
    return array;
  }

  /** Take a frame, and its array with it; one that is not newer than the last changes nothing. */
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
   * What to show at a time of our clock, into `out`; as many characters as fit. Null before the first frame.
   * Shown time goes forward only.
   */
  sample(nowMs: number, out: Float32Array): Sample | null {
    if (this.frames.length === 0) return null;
    const shownMs = this.playhead(nowMs);
    const sample = this.read(shownMs, out);
    const flags = this.fade(shownMs, sample.count * poseLength(this.joints), out) ? FLAGS.inTransition : 0;
    return { ...sample, head: { ...sample.head, flags: sample.head.flags | flags } };
  }

  private read(shownMs: number, out: Float32Array): Sample {
    let at = this.frames.length;
    while (at > 0 && (this.frames[at - 1] as Kept).dueMs > shownMs) at--;
    for (const frame of this.frames.slice(0, at)) if (frame.cut && frame !== this.entered) this.enter(frame);
    for (; at > 2; at--) this.recycle((this.frames.shift() as Kept).poses); // two before it tell the speed at the end
    if (at === 0) return this.at(this.frames[0] as Kept, this.frames[0] as Kept, 0, 0, out);
    const a = this.frames[at - 1] as Kept;
    const b = this.frames[at];
    if (b?.cut) return this.at(a, a, 0, 0, out);
    if (b) return this.at(a, b, (shownMs - a.dueMs) / (b.dueMs - a.dueMs), 0, out);
    return this.past(a, shownMs - a.dueMs, out);
  }

  /** The instant to show, on the server's clock. */
  private playhead(nowMs: number): number {
    const target = this.lateness.groundMs + this.delayMs;
    if (Number.isNaN(target)) return (this.frames[0] as Kept).dueMs;
    const passed = nowMs - this.sampledMs;
    if (Number.isNaN(this.lagMs) || Math.abs(target - this.lagMs) > SNAP_MS) this.lagMs = target;
    else if (passed > 0) this.lagMs += Math.min(Math.max(target - this.lagMs, -FASTER * passed), SLOWER * passed);
    this.sampledMs = Math.max(nowMs, this.sampledMs);
    return this.sampledMs - this.lagMs;
  }

  /** The motion goes on past its last frame as it went, for a moment. */
  private past(last: Kept, beyondMs: number, out: Float32Array): Sample {
    const before = this.frames.at(-2);
    const stepMs = before ? last.dueMs - before.dueMs : Number.POSITIVE_INFINITY;
    if (!before || last === this.entered || last.head.flags & FLAGS.last || stepMs > LONGEST_STEP * this.intervalMs)
      return this.at(last, last, 0, beyondMs, out);
    return this.at(before, last, 1 + Math.min(beyondMs, EXTRAPOLATE_MS) / stepMs, beyondMs, out);
  }

  /** Between two frames; past the second where the share is above 1. */
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

  /** Pass from what was shown before a cut; whether that is still under way. */
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
      const there = out.slice(start, start + 3);
      this.blend(this.left, out, start, start + stride, eased, out);
      const far = Math.hypot(...there.map((value, k) => value - (this.left[start + k] as number)));
      if (far > FARTHEST) out.set(there, start);
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
    else this.spare[0] = poses; // sizes change with the crowd; the oldest goes
  }
}

/** A difference of phases, the shorter way round. */
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
