/**
 * Protocol state of a stream without its socket.
 *
 * The page sets a target. Each step sends every channel the missing changes, with a bounded number of messages, so
 * that a crowd of 1,000 opens and closes in bursts that the server can answer.
 */

import { crowdPhase } from "../crowd";
import type { Connection, Opened, Stats } from "../types";
import type { Channel } from "./channel";
import { Clock, Lateness } from "./clock";
import {
  DecodeError,
  type Goal,
  type Layout,
  layoutOf,
  MESSAGE_HEAD_BYTES,
  readChannel,
  readMessageHead,
  readRecordHead,
  writeAdverbs,
  writeBulkAdverbs,
} from "./decode";
import { FigureStream } from "./figure_stream";
import { readText, type ServerMessage } from "./server_messages";
import { StreamCounters } from "./stream_stats";
import type { Drawn, FromWorker, Motion, StreamTarget } from "./worker_messages";

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

export class Session {
  private readonly streams: Record<"main" | "comparison", FigureStream>;
  private readonly counters: StreamCounters;
  private readonly clock = new Clock();
  private target: StreamTarget | null = null;
  /** Motion of the characters after the first, near and distant. */
  private crowd: Motion | null = null;
  private slow: Motion | null = null;
  private send: ((message: string | ArrayBuffer) => void) | null = null;
  /** Away: no session. Joining: a resume is being answered. */
  private state: "away" | "joining" | "live" = "away";
  private name = "";
  private sequence = 0;
  private mostChannels = 1024;
  private pings = new Map<number, number>();
  private token = 0;
  private barrier = -1;
  /** Session offered on this connection; used if there is none to resume. */
  private offeredSession = "";
  private confirmed = new Set<number>();
  /** Record layouts by channel, including closed channels whose records may still arrive. */
  private layouts = new Map<number, Layout>();
  /** Number of channels that wait for an answer. */
  private pending = 0;
  private soughtSerial = -1;
  private nextChannel = 0;
  /** New goals of this step. */
  private goals: Goal[] = [];
  private alignedMs = Number.NEGATIVE_INFINITY;

  constructor(
    private readonly emit: (message: FromWorker) => void,
    private readonly lateness = new Lateness(),
  ) {
    this.streams = { main: new FigureStream(0, lateness), comparison: new FigureStream(COMPARISON_CHANNEL, lateness) };
    this.counters = new StreamCounters(this.clock, this.lateness);
  }

  get connection(): Connection {
    return this.state === "live" ? "open" : this.name ? "lost" : "connecting";
  }

  get channels(): number {
    return this.all().filter((channel) => channel.isOpen).length;
  }

  setTarget(target: StreamTarget): void {
    this.target = target;
    this.crowd = target.crowd ?? target.main;
    this.slow = { ...this.crowd, fps: Math.max(1, Math.round(this.crowd.fps / 2)) };
    this.streams.main.setTarget(Math.max(1, Math.min(target.adverbs.length, this.mostChannels - 1)));
    this.streams.comparison.setTarget(target.comparison ? 1 : 0);
    for (const { buffer } of Object.values(this.streams)) {
      buffer.speed = target.main.speed;
      buffer.intervalMs = 1000 / target.main.fps;
    }
  }

  /** A socket is open; the server sends the first message. */
  attach(send: (message: string | ArrayBuffer) => void): void {
    this.send = send;
  }

  lost(): void {
    this.send = null;
    this.state = "away";
    this.pings.clear();
  }

  /** Whether a ping has been unanswered for longer than `mostMs`. */
  silent(nowMs: number, mostMs: number): boolean {
    const oldest = this.pings.values().next().value;
    return oldest !== undefined && nowMs - oldest > mostMs;
  }

  ping(nowMs: number): number {
    this.pings.set(++this.token, nowMs);
    this.send?.(JSON.stringify({ op: "ping", t: this.token }));
    return this.token;
  }

  /** Handle a message; throws `DecodeError` if it is unreadable. */
  receive(content: string | ArrayBuffer, nowMs: number): void {
    this.counters.bytes += typeof content === "string" ? content.length : content.byteLength;
    if (typeof content === "string") this.text(readText(content), nowMs);
    else this.poses(new DataView(content), nowMs);
  }

  draw(atMs: number, spare: Float32Array[]): Record<"main" | "comparison", Drawn | null> {
    return { main: this.streams.main.draw(atMs, spare), comparison: this.streams.comparison.draw(atMs, spare) };
  }

  stats(nowMs: number): Stats {
    return this.counters.snapshot(nowMs, this.connection, this.channels, this.streams.main.buffer.delayMs);
  }

  /** Send messages toward the target. */
  step(nowMs: number): void {
    if (this.state !== "live" || !this.send || !this.target) return;
    const { target } = this;
    const { main, comparison } = this.streams;
    const steered = target.adverbs[0] ?? [];
    const now = main.channels[0]?.phase ?? Number.NaN;
    const phase = Number.isNaN(now) || this.soughtSerial !== target.main.seek.serial ? target.main.seek.phase : now;
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

  private sendGoals(): void {
    const [first, ...others] = this.goals;
    this.goals = [];
    if (!first) return;
    const messages =
      others.length > 0 ? writeBulkAdverbs([first, ...others]) : [writeAdverbs(first.channel, first.adverbs)];
    for (const message of messages) this.send?.(message);
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
        this.send?.(message);
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
    this.send?.(JSON.stringify({ op: "set", channel: comparison.number, phase: Math.min(Math.max(main.phase, 0), 1) }));
  }

  private poses(view: DataView, nowMs: number): void {
    const head = readMessageHead(view);
    const step = (head.sequence - this.sequence) >>> 0;
    if (step === 0 || step >= 2 ** 31) return;
    if (step > 1 && this.sequence > 0) this.counters.gaps++;
    this.sequence = head.sequence;
    this.lateness.add(nowMs, head.timeMs);
    let at = MESSAGE_HEAD_BYTES;
    for (let k = 0; k < head.records; k++) {
      const number = readChannel(view, at);
      const layout = this.layouts.get(number);
      if (!layout) throw new DecodeError(at, `a record of channel ${number}, which was not opened`);
      const record = readRecordHead(view, at, layout);
      for (const role of Object.values(this.streams)) {
        const channel = role.find(number);
        if (channel?.isOpen) role.take(view, at, channel, layout, record);
      }
      at += layout.recordBytes;
    }
    this.counters.message(head.records, head.dropped);
    for (const role of Object.values(this.streams)) role.commit(head.timeMs);
  }

  private text(message: ServerMessage, nowMs: number): void {
    switch (message.op) {
      case "hello":
        return this.greeted(message, nowMs);
      case "opened":
        return this.opened(message);
      case "pong":
        return this.pong(message.t, message.server_time_ns, nowMs);
      case "error":
        return this.refused(message.channel, message.code, message.detail, nowMs);
      case "version":
        return this.renewed(message.channel, message.version, message.record_bytes);
      case "events":
        for (const { channel, name, phase } of message.items)
          if (channel === 0) this.emit({ kind: "event", name, phase });
        return;
      case "end":
        if (message.channel === 0) this.emit({ kind: "end" });
    }
  }

  private greeted(hello: { session: string; max_channels: number }, nowMs: number): void {
    this.mostChannels = hello.max_channels;
    this.lateness.clear();
    this.offeredSession = hello.session;
    if (this.name && this.all().some((channel) => channel.isOpen)) {
      this.counters.reconnects++;
      this.state = "joining";
      this.confirmed.clear();
      this.send?.(JSON.stringify({ op: "resume", session: this.name, last_seq: this.sequence }));
      this.barrier = this.ping(nowMs); // all answers to the resume precede this pong
    } else this.begin(nowMs);
  }

  /** Start a new session with a new clock. */
  private begin(nowMs: number): void {
    this.name = this.offeredSession;
    this.sequence = 0;
    this.barrier = -1;
    this.clock.clear();
    this.layouts.clear();
    this.counters.startSession();
    for (const channel of this.all()) channel.forget();
    for (const role of Object.values(this.streams)) role.reset();
    this.state = "live";
    this.ping(nowMs);
    this.step(nowMs);
  }

  private opened(opened: Opened): void {
    this.layouts.set(opened.channel, layoutOf(opened.encoding, opened.joints.length, opened.record_bytes));
    this.confirmed.add(opened.channel);
    for (const role of ROLES) {
      const channel = this.streams[role].find(opened.channel);
      if (channel && this.streams[role].opened(channel, opened)) this.emit({ kind: "opened", role, opened });
    }
  }

  private pong(token: number, serverNs: number, nowMs: number): void {
    const sentMs = this.pings.get(token);
    this.pings.delete(token);
    if (sentMs !== undefined) this.clock.add(sentMs, nowMs, serverNs / 1e6);
    if (token !== this.barrier) return;
    this.barrier = -1;
    for (const channel of this.all()) if (!this.confirmed.has(channel.number)) channel.forget();
    this.state = "live";
    this.step(nowMs);
  }

  private refused(number: number | null, code: string, detail: string, nowMs: number): void {
    if (code === "unknown_session" && this.state === "joining") return this.begin(nowMs);
    const role = number !== null && this.streams.comparison.find(number) ? "comparison" : "main";
    const channel = number === null ? undefined : this.streams[role].find(number);
    channel?.refused(code === "not_ready" ? nowMs + NOT_READY_MS : Number.POSITIVE_INFINITY);
    if (code !== "not_ready") this.emit({ kind: "refused", role, code, detail });
  }

  private renewed(number: number, version: number, recordBytes: number): void {
    const layout = this.layouts.get(number);
    if (layout) this.layouts.set(number, layoutOf(layout.encoding, layout.joints, recordBytes));
    const opened = number === 0 ? this.streams.main.channels[0]?.opened : null;
    if (opened) this.emit({ kind: "version", verb: opened.verb, version });
  }

  private all(): Channel[] {
    return [...this.streams.main.channels, ...this.streams.comparison.channels];
  }
}
