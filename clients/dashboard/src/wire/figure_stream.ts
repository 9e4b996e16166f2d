/** One side of the picture: its channels, and the buffer from which it is drawn. */

import type { Opened } from "../types";
import { JitterBuffer } from "./buffer";
import { Channel } from "./channel";
import type { Lateness } from "./clock";
import { DecodeError, FLAGS, type Layout, poseLength, type RecordHead, readPose } from "./decode";
import type { Drawn } from "./worker_messages";

export class Side {
  readonly buffer: JitterBuffer;
  /** By slot: the first is the one that is steered. */
  readonly channels: Channel[] = [];
  private skeleton = "";
  private joints = 0;
  /** Slots of which records have come on this skeleton, without a hole. */
  private seen = 0;
  private poses: Float32Array | null = null;
  private head: RecordHead | null = null;
  /** Characters that are wished. */
  wanted = 0;
  private reached = true;

  constructor(
    private readonly first: number,
    lateness: Lateness,
  ) {
    this.buffer = new JitterBuffer(lateness);
  }

  /** The channel of a number, if it is one of this side's. */
  find(number: number): Channel | undefined {
    return this.channels[number - this.first];
  }

  /** So many characters are wished; channels that are not are kept, until the server has heard it. */
  want(characters: number): void {
    while (this.channels.length < characters) this.channels.push(new Channel(this.first + this.channels.length));
    this.wanted = characters;
    this.seen = Math.min(this.seen, characters);
  }

  /** A channel was opened; whether it is the steered one, as it is wished now. */
  opened(channel: Channel, opened: Opened): boolean {
    if (!channel.answered(opened) || channel.number !== this.first) return false;
    const skeleton = keyOf(opened);
    if (skeleton !== this.skeleton) {
      this.joints = opened.joints.length;
      this.skeleton = skeleton;
      this.seen = 0;
      this.buffer.reset(this.joints);
    }
    this.reached = opened.resumed;
    return true;
  }

  /** Take the record at a byte, whose head was read. */
  take(view: DataView, at: number, channel: Channel, layout: Layout, head: RecordHead): void {
    channel.phase = head.phase;
    const slot = channel.number - this.first;
    if (!channel.opened || slot > this.seen || keyOf(channel.opened) !== this.skeleton) return;
    if (layout.joints !== this.joints) throw new DecodeError(at, "a record on another skeleton");
    this.poses ??= this.buffer.blank(this.wanted);
    const offset = slot * poseLength(this.joints);
    if (offset >= this.poses.length) return;
    readPose(view, at, layout, this.poses, offset);
    this.seen = Math.max(this.seen, slot + 1);
    if (slot === 0) this.head = head;
  }

  /** All records of a message were taken. */
  commit(dueMs: number): void {
    const { poses, head } = this;
    const before = this.buffer.last;
    this.poses = this.head = null;
    if (!poses || !(head ?? before)) return;
    const count = Math.min(this.seen, this.wanted);
    this.buffer.push({ dueMs, head: (head ?? before?.head) as RecordHead, count, poses }, this.reached);
    if (head) this.reached = true;
  }

  draw(atMs: number, spare: Float32Array[]): Drawn | null {
    const most = Math.min(this.seen, this.wanted) * poseLength(this.joints);
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
        verb: opened.verb,
        version: head.version,
        method: opened.method,
        phase: head.phase,
        time_s: head.timeS,
        duration_s: head.durationS,
        error: head.error,
        clamped: (head.flags & FLAGS.clamped) !== 0,
        inTransition: (head.flags & FLAGS.inTransition) !== 0,
        root: [poses[0] as number, poses[1] as number, poses[2] as number],
        count,
      },
    };
  }

  /** Another server, or nothing to be shown: start anew. */
  reset(): void {
    this.buffer.reset(this.joints);
    this.skeleton = "";
    this.seen = 0;
    this.reached = true;
  }
}

/** Two openings with one key move the same joints. */
function keyOf(opened: Opened): string {
  return `${opened.joints.join("\n")}\n${opened.skeleton.parents.join()}`;
}
