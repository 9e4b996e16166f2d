/**
 * Channels of the page's figures: a crowd and a comparison.
 *
 * The page sets a target. Each step sends every channel the missing changes, with a bounded number of messages, so
 * that a crowd of 1,000 opens and closes in bursts that the server can answer. Of a crowd, weights are streamed where
 * they change; the steered character is streamed as poses, with planted feet.
 */

import {
  type Channel,
  type Drawn,
  type Evaluators,
  FigureStream,
  type Goal,
  type Lateness,
  type Layout,
  type Motion,
  type Opened,
  Protocol,
  type ProtocolEvents,
  type RecordHead,
  type StreamStats,
  writeAdverbs,
  writeBulkAdverbs,
} from "adverb-client";
import { crowdPhase } from "../crowd";
import type { FromWorker, StreamTarget } from "./worker_messages";

/** Limit of unanswered `open` messages; the server queues at most 256 messages. */
const MOST_PENDING = 48;
/** Text messages per step. */
const MOST_SENT = 192;
const COMPARISON_CHANNEL = 60_000;
const NOT_READY_MS = 1000;
/** Phase tolerance between the figures, and interval of corrections. */
const ALIGNED = 0.01;
const ALIGN_MS = 500;
const ROLES = ["main", "comparison"] as const;
/** The page shows keytimes of the steered character only. */
const QUIET = { options: { events: false } };

export class Session implements ProtocolEvents {
  readonly protocol: Protocol;
  private readonly streams: Record<"main" | "comparison", FigureStream>;
  private target: StreamTarget | null = null;
  /** Motion of the characters after the first, near and distant. */
  private crowd: Motion | null = null;
  private slow: Motion | null = null;
  /** Number of channels that wait for an answer. */
  private pending = 0;
  private soughtSerial = -1;
  private nextChannel = 0;
  /** New goals of this step. */
  private goals: Goal[] = [];
  private alignedMs = Number.NEGATIVE_INFINITY;

  constructor(
    private readonly emit: (message: FromWorker) => void,
    lateness?: Lateness,
    private readonly evaluators: Evaluators | null = null,
  ) {
    this.protocol = new Protocol(this, lateness);
    const { lateness: known } = this.protocol;
    this.streams = {
      main: new FigureStream(0, known, evaluators),
      comparison: new FigureStream(COMPARISON_CHANNEL, known),
    };
  }

  get openChannels(): number {
    return this.all().filter((channel) => channel.isOpen).length;
  }

  setTarget(target: StreamTarget): void {
    const comparison = target.comparison && { ...target.comparison, ...QUIET };
    this.target = { ...target, main: { ...target.main, options: { events: true } }, comparison };
    this.setCrowd(target);
    this.streams.main.setTarget(Math.max(1, Math.min(target.adverbs.length, this.protocol.maxChannels - 1)));
    this.streams.comparison.setTarget(target.comparison ? 1 : 0);
    for (const { buffer } of Object.values(this.streams)) {
      buffer.speed = target.main.speed;
      buffer.intervalMs = 1000 / target.main.fps;
    }
  }

  /** Weights of the crowd are streamed where its verb can be evaluated here, poses otherwise. */
  private setCrowd(target: StreamTarget): void {
    const motion = target.crowd ?? target.main;
    const opened = this.streams.main.channels[0]?.opened;
    const known = opened?.verb === motion.verb ? opened : null;
    const evaluable =
      target.weights && this.evaluators && !(known && this.evaluators.failure(known.verb, known.version));
    this.crowd = { ...motion, ...QUIET, ...(evaluable && { encoding: "weights" }) };
    this.slow = { ...this.crowd, fps: Math.max(1, Math.round(this.crowd.fps / 2)) };
  }

  draw(atMs: number, spare: Float32Array[]): Record<"main" | "comparison", Drawn | null> {
    return { main: this.streams.main.draw(atMs, spare), comparison: this.streams.comparison.draw(atMs, spare) };
  }

  stats(nowMs: number): StreamStats {
    return this.protocol.stats(nowMs, this.streams.main.buffer.delayMs);
  }

  /** Send messages toward the target. */
  step(nowMs: number): void {
    if (!this.protocol.live || !this.target) return;
    const { target } = this;
    const { main, comparison } = this.streams;
    const steered = target.adverbs[0] ?? [];
    const now = main.channels[0]?.phase ?? Number.NaN;
    const phase = Number.isNaN(now) || this.soughtSerial !== target.main.seek.serial ? target.main.seek.phase : now;
    this.setCrowd(target);
    let left = MOST_SENT;
    this.pending = this.all().reduce((sum, channel) => sum + Number(channel.pending), 0);
    left -= this.updateChannel(main.channels[0], target.main, steered, phase, nowMs);
    if (main.channels[0]?.isOpen) this.soughtSerial = target.main.seek.serial;
    left -= this.updateChannel(comparison.channels[0], target.comparison, steered, phase, nowMs);
    this.align(nowMs);
    for (let k = main.channels.length - 1; k > 0 && left > 0; k--) {
      this.nextChannel = (this.nextChannel % (main.channels.length - 1)) + 1;
      const slot = this.nextChannel;
      const motion = slot < main.targetCount ? (target.distant?.[slot] ? this.slow : this.crowd) : null;
      const at = target.main.playing ? crowdPhase(slot, phase) : phase;
      left -= this.updateChannel(main.channels[slot], motion, target.adverbs[slot] ?? steered, at, nowMs);
    }
    this.sendGoals();
  }

  /** A new session: no channel is open. */
  started(nowMs: number): void {
    for (const channel of this.all()) channel.forget();
    for (const role of Object.values(this.streams)) role.reset();
    this.step(nowMs);
  }

  /** A resumed session: channels that the server did not confirm are opened again. */
  resumed(channels: ReadonlySet<number>, nowMs: number): void {
    for (const channel of this.all()) if (!channels.has(channel.number)) channel.forget();
    this.step(nowMs);
  }

  opened(opened: Opened): void {
    for (const role of ROLES) {
      const channel = this.streams[role].find(opened.channel);
      if (channel && this.streams[role].opened(channel, opened)) this.emit({ kind: "opened", role, opened });
    }
  }

  rejected(number: number | null, code: string, detail: string, nowMs: number): void {
    const role = number !== null && this.streams.comparison.find(number) ? "comparison" : "main";
    const channel = number === null ? undefined : this.streams[role].find(number);
    if (channel?.pending && !channel.answers(code)) return;
    channel?.refused(code, code === "not_ready" ? nowMs + NOT_READY_MS : Number.POSITIVE_INFINITY);
    if (code === "channel_in_use") return;
    if (code !== "not_ready") this.emit({ kind: "refused", role, code, detail });
  }

  record(view: DataView, at: number, layout: Layout, head: RecordHead): void {
    for (const role of Object.values(this.streams)) {
      const channel = role.find(head.channel);
      if (channel?.isOpen) role.take(view, at, channel, layout, head);
    }
  }

  tick(dueMs: number): void {
    for (const role of Object.values(this.streams)) role.commit(dueMs);
  }

  version(number: number, version: number): void {
    const opened = number === 0 ? this.streams.main.channels[0]?.opened : null;
    if (opened) this.emit({ kind: "version", verb: opened.verb, version });
  }

  keytime(channel: number, name: string, phase: number): void {
    if (channel === 0) this.emit({ kind: "event", name, phase });
  }

  ended(channel: number): void {
    if (channel === 0) this.emit({ kind: "end" });
  }

  private sendGoals(): void {
    const [first, ...others] = this.goals;
    this.goals = [];
    if (!first) return;
    const messages =
      others.length > 0 ? writeBulkAdverbs([first, ...others]) : [writeAdverbs(first.channel, first.adverbs)];
    for (const message of messages) this.protocol.send(message);
  }

  /** Update one channel, or close it without a motion; returns the number of text messages. */
  private updateChannel(
    channel: Channel | undefined,
    motion: Motion | null,
    adverbs: readonly number[],
    phase: number,
    nowMs: number,
  ): number {
    if (!channel || (motion && !channel.isOpen && this.pending >= MOST_PENDING)) return 0;
    const messages = motion ? channel.next(motion, adverbs, phase, nowMs) : channel.isOpen ? [channel.close()] : [];
    let texts = 0;
    for (const message of messages) {
      if (typeof message !== "string") this.goals.push(message);
      else {
        this.protocol.send(message);
        texts++;
      }
    }
    if (texts > 0 && channel.pending) this.pending++;
    return texts;
  }

  /** Blended durations differ by method: realign the comparison's phase when it drifts. */
  private align(nowMs: number): void {
    const [main, comparison] = [this.streams.main.channels[0], this.streams.comparison.channels[0]];
    if (!main?.settled || !comparison?.settled || !this.target?.main.playing || nowMs < this.alignedMs + ALIGN_MS)
      return;
    const apart = comparison.phase - main.phase;
    if (Math.abs(apart - Math.round(apart)) < ALIGNED) return;
    this.alignedMs = nowMs;
    const phase = Math.min(Math.max(main.phase, 0), 1);
    this.protocol.send(JSON.stringify({ op: "set", channel: comparison.number, phase }));
  }

  private all(): Channel[] {
    return [...this.streams.main.channels, ...this.streams.comparison.channels];
  }
}
