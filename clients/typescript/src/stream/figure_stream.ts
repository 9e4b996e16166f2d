/** Stream of one figure: its channels and its jitter buffer. */

import { DecodeError } from "../errors.js";
import type { Opened } from "../schema.js";
import { FLAGS, type Layout, poseLength, type RecordHead, readPose } from "../wire/decode.js";
import { JitterBuffer } from "./buffer.js";
import { Channel } from "./channel.js";
import type { Lateness } from "./clock.js";
import type { Drawn } from "./motion.js";

export class FigureStream {
  readonly buffer: JitterBuffer;
  /** By slot; the first is the steered character. */
  readonly channels: Channel[] = [];
  private skeleton = "";
  private joints = 0;
  /** Number of leading slots with records on this skeleton. */
  private seen = 0;
  private poses: Float32Array | null = null;
  private head: RecordHead | null = null;
  /** Target number of characters. */
  targetCount = 0;
  private reached = true;

  constructor(
    private readonly first: number,
    lateness: Lateness,
  ) {
    this.buffer = new JitterBuffer(lateness);
  }

  /** The channel with a number, if it belongs to this figure. */
  find(number: number): Channel | undefined {
    return this.channels[number - this.first];
  }

  /** Set the number of characters; surplus channels remain until they are closed. */
  setTarget(characters: number): void {
    while (this.channels.length < characters) this.channels.push(new Channel(this.first + this.channels.length));
    this.targetCount = characters;
    this.seen = Math.min(this.seen, characters);
  }

  /** Handle `opened`; returns whether it is the steered channel in its current target. */
  opened(channel: Channel, opened: Opened): boolean {
    if (!channel.acceptOpened(opened) || channel.number !== this.first) return false;
    const skeleton = keyOf(opened);
    if (skeleton !== this.skeleton) {
      this.joints = opened.joints.length;
      this.skeleton = skeleton;
      this.seen = 0;
      this.buffer.reset(this.joints);
    }
    this.reached = opened.resumed || channel.continued;
    return true;
  }

  /** Read the record at a byte offset, whose head was read. */
  take(view: DataView, at: number, channel: Channel, layout: Layout, head: RecordHead): void {
    channel.phase = head.phase;
    const slot = channel.number - this.first;
    if (!channel.opened || slot > this.seen || keyOf(channel.opened) !== this.skeleton) return;
    if (layout.joints !== this.joints) throw new DecodeError(at, "a record on another skeleton");
    this.poses ??= this.buffer.blank(this.targetCount);
    const offset = slot * poseLength(this.joints);
    if (offset >= this.poses.length) return;
    readPose(view, at, layout, this.poses, offset);
    this.seen = Math.max(this.seen, slot + 1);
    if (slot === 0) this.head = { ...head, verb: channel.opened.verb };
  }

  /** All records of a message were read. */
  commit(dueMs: number): void {
    const { poses, head } = this;
    const before = this.buffer.last;
    this.poses = this.head = null;
    if (!poses || !(head ?? before)) return;
    const count = Math.min(this.seen, this.targetCount);
    this.buffer.push({ dueMs, head: (head ?? before?.head) as RecordHead, count, poses }, this.reached);
    if (head) this.reached = true;
  }

  draw(atMs: number, spare: Float32Array[]): Drawn | null {
    const most = Math.min(this.seen, this.targetCount) * poseLength(this.joints);
    const opened = this.channels[0]?.opened;
    if (!opened || most === 0) return null;
    const at = spare.findIndex((array) => array.length === most);
    const poses = at < 0 ? new Float32Array(most) : (spare.splice(at, 1)[0] as Float32Array);
    const sample = this.buffer.sample(atMs, poses);
    if (!sample) return null;
    const { head, count } = sample;
    return {
      poses,
      shown: {
        verb: head.verb ?? opened.verb,
        version: head.version,
        method: opened.method,
        phase: head.phase,
        timeS: head.timeS,
        durationS: head.durationS,
        error: head.error,
        clamped: (head.flags & FLAGS.clamped) !== 0,
        inTransition: (head.flags & FLAGS.inTransition) !== 0,
        root: [poses[0] as number, poses[1] as number, poses[2] as number],
        count,
      },
    };
  }

  /** Discard everything, for another server or an empty figure. */
  reset(): void {
    this.buffer.reset(this.joints);
    this.skeleton = "";
    this.seen = 0;
    this.reached = true;
  }
}

/** Equal keys mean equal joints. */
function keyOf(opened: Opened): string {
  return `${opened.joints.join("\n")}\n${opened.skeleton.parents.join()}`;
}
