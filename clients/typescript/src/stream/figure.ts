/** One character of a stream. */

import { completeAdverbs, namedAdverbs } from "../adverbs.js";
import { BadRequest, StreamClosed } from "../errors.js";
import type { Evaluators } from "../evaluator/evaluators.js";
import { type Rig, rigOf, type Skeleton, solve } from "../math/kinematics.js";
import type { Opened, Verb } from "../schema.js";
import { type Encoding, type Layout, poseLength, type RecordHead } from "../wire/decode.js";
import type { Outgoing } from "./channel.js";
import type { Lateness } from "./clock.js";
import { FigureStream } from "./figure_stream.js";
import type { Motion, Shown } from "./motion.js";

/** Settings that can change at any time. */
export interface FigureSettings {
  /** Goal by name, in the verb's units; adverbs that are not named keep their value. */
  adverbs?: Readonly<Record<string, number>>;
  /** Playback speed, −10 to 10. */
  speed?: number;
  playing?: boolean;
  /** Default: the verb's own. */
  loop?: boolean;
  /** Seek, 0 to 1. */
  phase?: number;
  /** Frames per second, 1 to 120. */
  fps?: number;
  /** Time in which half of the distance to a new goal is covered, s. */
  halfLife?: number;
}

/** Options of a `switch`. */
export interface SwitchOptions {
  /** Goal by name; default: the middle of the domain. */
  adverbs?: Readonly<Record<string, number>>;
  /** Blending method; default: the verb's own. */
  method?: string;
  /** Duration of the transition, 0 to 5 s; default: chosen by the server. */
  transitionS?: number;
}

export interface FigureOptions extends FigureSettings {
  /** Blending method; default: the verb's own. */
  method?: string;
  /**
   * `weights`: the server sends weights where they change only, and the poses are evaluated here, without planted feet
   * and with all joints, local, as glTF has them.
   */
  encoding?: Encoding;
  /** Joints of the poses, in this order; default: all. */
  joints?: readonly string[];
  /** Rotations relative to the parent, or global. */
  space?: "local" | "global";
  frame?: "gltf" | "unity" | "unreal" | "zup";
  /** Whether feet that stand are held where they landed. */
  plant?: boolean;
  follow?: boolean;
  /** Whether keytimes are reported. */
  events?: boolean;
  /** Whether poses have their support by the examples. */
  support?: boolean;
  /** Weight in a byte budget. */
  priority?: number;
  /** Receiver of VMC that the server's operator has named; it gets the poses too. */
  vmc?: string;
}

/** Displayed pose of a figure. */
export interface Pose extends Omit<Shown, "count" | "root"> {
  /** Root x, y, z (m), then x, y, z, w per joint; a new array for each pose. */
  values: Float32Array;
  /** Of the verb, in the frame of the figure. */
  skeleton: Skeleton;
}

/** What a figure needs of its stream. */
export interface FigureHost {
  /** Settings changed: messages are due. */
  changed(): void;
  send(message: string): void;
  describe(verb: string): Promise<Verb>;
  closed(): void;
}

const SETTINGS = ["speed", "playing", "loop", "fps", "halfLife"] as const;
const OPEN_FIELDS = ["joints", "space", "frame", "plant", "follow", "events", "support", "priority", "vmc"] as const;

export class Figure {
  private readonly stream: FigureStream;
  private motion: Motion;
  private adverbs: readonly number[];
  /** Of the skeleton that `positions` was called with. */
  private rig: { skeleton: Skeleton; rig: Rig } | null = null;
  /** Serial of the last seek that was sent. */
  private soughtSerial = -1;
  /** State to return to if the pending `switch` is refused. */
  private before: { motion: Motion; adverbs: readonly number[]; description: Verb } | null = null;
  /** Settings that changed while it was pending. */
  private changed: Partial<Motion> = {};
  /** Serial of the last `switch`. */
  private switchSerial = 0;
  /** The last `switch` is settled. */
  private switched: Promise<unknown> = Promise.resolve();
  /** The answer to `open` or `switch`. */
  answered!: Promise<void>;
  /** It is not settled. */
  private awaited = true;
  private accept: () => void = () => {};
  private reject: (reason: Error) => void = () => {};
  private readonly waiting: { done(pose: Pose): void; failed(reason: Error): void }[] = [];
  private ended: Error | null = null;

  /** Use `Stream.open`. */
  constructor(
    number: number,
    private description: Verb,
    options: FigureOptions,
    lateness: Lateness,
    private readonly host: FigureHost,
    evaluators: Evaluators | null = null,
  ) {
    if (options.encoding === "weights" && (options.joints || options.space || options.frame))
      throw new BadRequest(0, "bad_request", "weights are evaluated to all joints, local, in the frame gltf");
    this.stream = new FigureStream(number, lateness, evaluators);
    this.stream.setTarget(1);
    this.adverbs = completeAdverbs(description, options.adverbs ?? {});
    if (options.frame === "unreal") this.stream.buffer.unitsPerMetre = 100;
    const given = OPEN_FIELDS.filter((name) => options[name] !== undefined);
    this.motion = {
      verb: description.name,
      method: options.method ?? "",
      names: description.adverbs.map(({ name }) => name),
      fps: options.fps ?? 60,
      encoding: options.encoding ?? "f32",
      playing: options.playing ?? true,
      speed: options.speed ?? 1,
      seek: { serial: 0, phase: options.phase ?? 0 },
      options: Object.fromEntries(given.map((name) => [name, options[name]])),
      ...(options.loop !== undefined && { loop: options.loop }),
      ...(options.halfLife !== undefined && { halfLife: options.halfLife }),
    };
    this.setBuffer();
    this.wait();
  }

  /** Description of the current verb. */
  get verb(): Verb {
    return this.description;
  }

  /** Answer to the last `open` or `switch`; null before the first. */
  get info(): Opened | null {
    return this.channel.opened;
  }

  /** Number and state on the wire. */
  get channel() {
    return this.stream.channels[0] as NonNullable<(typeof this.stream.channels)[0]>;
  }

  /** Current goal by name. */
  get goal(): Record<string, number> {
    return namedAdverbs(this.description, this.adverbs);
  }

  /** Display delay of the jitter buffer, ms. */
  get delayMs(): number {
    return this.stream.buffer.delayMs;
  }

  /** Change settings; changes of one turn of the event loop are sent together. */
  set(settings: FigureSettings): void {
    if (settings.adverbs) this.adverbs = completeAdverbs(this.description, settings.adverbs, this.adverbs);
    const given = SETTINGS.filter((name) => settings[name] !== undefined);
    const changed: Partial<Motion> = Object.fromEntries(given.map((name) => [name, settings[name]]));
    if (settings.phase !== undefined) changed.seek = { serial: this.motion.seek.serial + 1, phase: settings.phase };
    this.motion = { ...this.motion, ...changed };
    Object.assign(this.changed, changed);
    this.setBuffer();
    this.host.changed();
  }

  /** Change the goal; adverbs that are not named keep their value. */
  aim(adverbs: Readonly<Record<string, number>>): void {
    this.set({ adverbs });
  }

  /**
   * Continue with another verb of the same joints, with a transition that keeps position and heading.
   *
   * A switch begins when the one before is answered.
   *
   * @throws ChannelError code `skeleton_mismatch`: the verb has other joints
   * @throws StreamClosed the figure or the stream was closed
   */
  switch(verb: string, options: SwitchOptions = {}): Promise<void> {
    const answer = this.switched.then(() => this.switchTo(verb, options));
    this.switched = answer.catch(() => {});
    return answer;
  }

  private async switchTo(verb: string, { adverbs = {}, method = "", transitionS }: SwitchOptions): Promise<void> {
    const description = await this.host.describe(verb);
    if (this.ended) throw this.ended;
    const goal = completeAdverbs(description, adverbs);
    const { loop: _, transitionS: __, ...kept } = this.motion;
    const before = { motion: this.motion, adverbs: this.adverbs, description: this.description };
    this.before = before;
    this.changed = {};
    this.description = description;
    this.adverbs = goal;
    this.motion = {
      ...kept,
      verb,
      method,
      names: description.adverbs.map(({ name }) => name),
      playing: true,
      switches: true,
      switchSerial: ++this.switchSerial,
      ...(transitionS !== undefined && { transitionS }),
    };
    this.wait();
    this.host.changed();
    try {
      await this.answered;
    } catch (err) {
      Object.assign(this, before, { motion: { ...before.motion, ...this.changed } });
      this.host.changed();
      throw err;
    } finally {
      this.before = null;
    }
  }

  /**
   * Pose to display at a time; null before the first frame.
   *
   * @param atMs as `performance.now()` and the argument of `requestAnimationFrame`
   */
  pose(atMs: number = performance.now()): Pose | null {
    const drawn = this.stream.draw(performance.timeOrigin + atMs, []);
    if (!drawn) return null;
    const { count: _, root: __, ...shown } = drawn.shown;
    return { ...shown, values: drawn.poses, skeleton: this.info?.skeleton ?? this.description.skeleton };
  }

  /**
   * The first pose, when it has arrived.
   *
   * @throws StreamClosed the figure or the stream was closed
   */
  first(): Promise<Pose> {
    return new Promise((done, failed) => {
      const pose = this.pose();
      if (pose) done(pose);
      else if (this.ended) failed(this.ended);
      else this.waiting.push({ done, failed });
    });
  }

  /** Joint positions of a pose, 3 per joint, in its frame and unit. It needs all joints, and local rotations. */
  positions(pose: Pose): Float32Array {
    const { options } = this.motion;
    if (options?.joints || options?.space === "global" || pose.values.length !== poseLength(pose.skeleton.names.length))
      throw new BadRequest(0, "bad_request", "positions need the local rotations of all joints");
    if (this.rig?.skeleton !== pose.skeleton) this.rig = { skeleton: pose.skeleton, rig: rigOf(pose.skeleton) };
    const { rig } = this.rig;
    const positions = new Float32Array(3 * rig.joints);
    solve(rig, pose.values, 0, positions, new Float32Array(4 * rig.joints));
    return positions;
  }

  /** Remove the figure from the stream. */
  close(): void {
    if (this.channel.isOpen) this.host.send(this.channel.close());
    this.host.closed();
    this.end(new StreamClosed("the figure is closed"));
  }

  /** Whether a `switch` is unanswered. */
  get switching(): boolean {
    return this.before !== null;
  }

  /** The server refused `open` or `switch`; returns whether a caller waits for the answer. */
  refuse(reason: Error): boolean {
    const { awaited } = this;
    this.reject(reason);
    return awaited;
  }

  /** The figure is not on the stream any more. */
  end(reason: Error): void {
    this.ended ??= reason;
    this.reject(reason);
    for (const { failed } of this.waiting.splice(0)) failed(reason);
  }

  /** Messages toward the settings. */
  next(nowMs: number): Outgoing[] {
    const { channel, motion } = this;
    const sought = this.soughtSerial === motion.seek.serial && !Number.isNaN(channel.phase);
    const phase = sought ? Math.min(Math.max(channel.phase, 0), 1) : motion.seek.phase;
    const messages = channel.next(motion, this.adverbs, phase, nowMs);
    if (channel.isOpen) this.soughtSerial = motion.seek.serial;
    return messages;
  }

  /** The server answered `open`, `switch` or `resume`. */
  opened(opened: Opened): void {
    this.stream.opened(this.channel, opened);
    if (this.channel.has(this.motion)) this.accept();
  }

  record(view: DataView, at: number, layout: Layout, head: RecordHead): void {
    this.stream.take(view, at, this.channel, layout, head);
  }

  tick(dueMs: number): void {
    this.stream.commit(dueMs);
    this.arrived();
  }

  /** There may be a first pose. */
  arrived(): void {
    const pose = this.waiting.length > 0 ? this.pose() : null;
    if (pose) for (const { done } of this.waiting.splice(0)) done(pose);
  }

  /** Another session: the server does not have the channel, and its clock is another. */
  forget(): void {
    this.channel.forget();
    this.stream.reset();
  }

  private setBuffer(): void {
    this.stream.buffer.speed = this.motion.speed;
    this.stream.buffer.intervalMs = 1000 / this.motion.fps;
  }

  private wait(): void {
    this.awaited = true;
    this.answered = new Promise((done, failed) => {
      this.accept = done;
      this.reject = failed;
    });
    const settled = () => {
      this.awaited = false;
    };
    this.answered.then(settled, settled); // it is awaited where it is requested
  }
}
