/** Stream of one figure: its channels, its jitter buffer, and the characters that are evaluated here. */

import { DecodeError } from "../errors.js";
import type { Evaluators } from "../evaluator/evaluators.js";
import type { Opened } from "../schema.js";
import { FLAGS, type Layout, poseLength, type RecordHead, readPose, readWeights, supportOf } from "../wire/decode.js";
import { JitterBuffer } from "./buffer.js";
import { Channel } from "./channel.js";
import type { Lateness } from "./clock.js";
import type { Drawn } from "./motion.js";
import { Recipe, type RecipeRecord } from "./recipe.js";

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
  /** By slot; characters whose weights are streamed. */
  private readonly recipes: (Recipe | undefined)[] = [];
  /** Records of the message that is being read. */
  private fresh: { recipe: Recipe; record: Omit<RecipeRecord, "dueMs"> }[] = [];
  private readonly evaluatorOf = ({ verb = "", version }: RecordHead) => this.evaluators?.of(verb, version) ?? null;

  /** @param evaluators verbs of the characters whose weights are streamed */
  constructor(
    private readonly first: number,
    lateness: Lateness,
    private readonly evaluators: Evaluators | null = null,
  ) {
    this.buffer = new JitterBuffer(lateness);
  }

  /** Number of leading slots that can be displayed. */
  private get displayed(): number {
    let count = this.seen;
    while (count < this.targetCount && this.recipes[count]?.ready) count++;
    return Math.min(count, this.targetCount);
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
    this.recipes.length = Math.min(this.recipes.length, characters);
  }

  /** Handle `opened`; returns whether it is the steered channel in its current target. */
  opened(channel: Channel, opened: Opened): boolean {
    if (!channel.acceptOpened(opened) || channel.number !== this.first) return false;
    const skeleton = keyOf(opened);
    if (skeleton !== this.skeleton) {
      this.joints = opened.joints.length;
      this.skeleton = skeleton;
      this.seen = 0;
      for (const recipe of this.recipes) recipe?.reset();
      this.buffer.reset(this.joints);
    }
    this.reached = opened.resumed || channel.continued;
    return true;
  }

  /** Read the record at a byte offset, whose head was read. */
  take(view: DataView, at: number, channel: Channel, layout: Layout, head: RecordHead): void {
    channel.phase = head.phase;
    const slot = channel.number - this.first;
    if (layout.encoding === "weights") return this.takeWeights(slot, channel, readWeights(view, at, layout), head);
    if (this.recipes[slot]) this.recipes[slot] = undefined;
    if (!channel.opened || slot > this.seen || keyOf(channel.opened) !== this.skeleton) return;
    if (layout.joints !== this.joints) throw new DecodeError(at, "a record on another skeleton");
    this.poses ??= this.buffer.blank(this.targetCount - this.recipes.filter(Boolean).length);
    const offset = slot * poseLength(this.joints);
    if (offset >= this.poses.length) return;
    readPose(view, at, layout, this.poses, offset);
    this.seen = Math.max(this.seen, slot + 1);
    if (slot === 0) this.head = { ...head, verb: channel.opened.verb };
  }

  private takeWeights(slot: number, channel: Channel, weights: Float32Array, head: RecordHead): void {
    if (!channel.opened || slot >= this.targetCount) return;
    if (slot < this.seen) this.seen = slot; // its poses were streamed before
    this.recipes[slot] ??= new Recipe();
    const recipe = this.recipes[slot] as Recipe;
    const rate = head.flags & FLAGS.last ? 0 : channel.rate;
    const named = { ...head, verb: channel.opened.verb };
    this.fresh.push({ recipe, record: { head: named, weights, rate, loop: channel.loop } });
  }

  /** All records of a message were read. */
  commit(dueMs: number): void {
    for (const { recipe, record } of this.fresh.splice(0)) recipe.take({ ...record, dueMs });
    const { poses, head } = this;
    const before = this.buffer.last;
    this.poses = this.head = null;
    if (!poses || !(head ?? before)) return;
    const count = Math.min(this.seen, this.targetCount);
    this.buffer.push({ dueMs, head: (head ?? before?.head) as RecordHead, count, poses }, this.reached);
    if (head) this.reached = true;
  }

  draw(atMs: number, spare: Float32Array[]): Drawn | null {
    const opened = this.channels[0]?.opened;
    const length = poseLength(this.joints);
    const most = this.displayed;
    if (!opened || most === 0) return null;
    const at = spare.findIndex((array) => array.length === most * length);
    const poses = at < 0 ? new Float32Array(most * length) : (spare.splice(at, 1)[0] as Float32Array);
    const sample = this.seen > 0 ? this.buffer.sample(atMs, poses.subarray(0, this.seen * length)) : null;
    const count = this.evaluate(this.buffer.shownMs(atMs), sample?.count ?? 0, most, poses);
    const head = sample?.head ?? this.recipes[0]?.shown;
    if (!head || count === 0) return null;
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
        support: supportOf(head.flags),
        clamped: (head.flags & FLAGS.clamped) !== 0,
        inTransition: (head.flags & FLAGS.inTransition) !== 0,
        root: [poses[0] as number, poses[1] as number, poses[2] as number],
        count,
      },
    };
  }

  /** Evaluate the characters of slots from `count` up to `most`; returns the number of leading slots with a pose. */
  private evaluate(shownMs: number, count: number, most: number, poses: Float32Array): number {
    if (Number.isNaN(shownMs)) return count;
    const length = poseLength(this.joints);
    for (let slot = count; slot < most; slot++) {
      const out = poses.subarray(slot * length, (slot + 1) * length);
      if (!this.recipes[slot]?.write(shownMs, this.evaluatorOf, out)) return slot;
    }
    return most;
  }

  /** Discard everything, for another server or an empty figure. */
  reset(): void {
    this.buffer.reset(this.joints);
    this.skeleton = "";
    this.seen = 0;
    this.reached = true;
    this.recipes.length = 0;
    this.fresh = [];
  }
}

/** Equal keys mean equal joints. */
function keyOf(opened: Opened): string {
  return `${opened.joints.join("\n")}\n${opened.skeleton.parents.join()}`;
}
