/**
 * A stream's session without its socket: messages in, pictures and messages out.
 *
 * The page says what it wants to see; on every turn each channel is told what it lacks, a bounded number of messages
 * at a time, so that a crowd of a thousand comes and goes in bursts that the server can answer.
 */

import type { Connection, Opened, Stats } from "../types";
import type { Channel, Outgoing } from "./channel";
import { Clock, Lateness } from "./clock";
import {
  DecodeError,
  type Layout,
  layoutOf,
  MESSAGE_HEAD_BYTES,
  readChannel,
  readMessageHead,
  readRecordHead,
} from "./decode";
import { Side } from "./figure_stream";
import { readText, type ServerMessage } from "./server_messages";
import { Tally } from "./stream_stats";
import type { Drawn, FromWorker, Motion, Wish } from "./worker_messages";

/** Channels that may wait for an answer at a time: an answer has a skeleton in it, and the server keeps 256 messages. */
const MOST_PENDING = 48;
/** Messages that one turn may send. */
const MOST_SENT = 192;
const OTHER_CHANNEL = 60_000;
const NOT_READY_MS = 1000;
/** How far two phases may be apart, and how often that is looked at. */
const ALIGNED = 0.01;
const ALIGN_MS = 500;
const SIDES = ["main", "other"] as const;

export class Session {
  private readonly sides: Record<"main" | "other", Side>;
  private readonly tally: Tally;
  private readonly clock = new Clock();
  private wish: Wish | null = null;
  private send: ((message: Outgoing) => void) | null = null;
  /** Away: not greeted, nothing can be sent. Joining: a resume is not answered completely. */
  private state: "away" | "joining" | "live" = "away";
  private name = "";
  private sequence = 0;
  private mostChannels = 1024;
  private pings = new Map<number, number>();
  private token = 0;
  private barrier = -1;
  /** The session that the server offers on this connection; taken where there is none to resume. */
  private offered = "";
  private confirmed = new Set<number>();
  /** Layouts of the records that come, by channel; of closed ones too, since records may still be under way. */
  private layouts = new Map<number, Layout>();
  /** Channels that wait for an answer. */
  private pending = 0;
  private sought = -1;
  private turnAt = 0;
  private alignedMs = Number.NEGATIVE_INFINITY;

  constructor(
    private readonly tell: (message: FromWorker) => void,
    private readonly lateness = new Lateness(),
  ) {
    this.sides = { main: new Side(0, lateness), other: new Side(OTHER_CHANNEL, lateness) };
    this.tally = new Tally(this.clock, this.lateness);
  }

  get connection(): Connection {
    return this.state === "live" ? "open" : this.name ? "lost" : "connecting";
  }

  get channels(): number {
    return this.all().filter((channel) => channel.there).length;
  }

  want(wish: Wish): void {
    this.wish = wish;
    this.sides.main.want(Math.max(1, Math.min(wish.adverbs.length, this.mostChannels - 1)));
    this.sides.other.want(wish.other ? 1 : 0);
    for (const { buffer } of Object.values(this.sides)) {
      buffer.speed = wish.main.speed;
      buffer.intervalMs = 1000 / wish.main.fps;
    }
  }

  /** A socket is there; the server speaks first. */
  attach(send: (message: Outgoing) => void): void {
    this.send = send;
  }

  lost(): void {
    this.send = null;
    this.state = "away";
    this.pings.clear();
  }

  /** Whether a ping has waited so long that nobody can be there. */
  silent(nowMs: number, mostMs: number): boolean {
    const oldest = this.pings.values().next().value;
    return oldest !== undefined && nowMs - oldest > mostMs;
  }

  ping(nowMs: number): number {
    this.pings.set(++this.token, nowMs);
    this.send?.(JSON.stringify({ op: "ping", t: this.token }));
    return this.token;
  }

  /** Take a message; throws `DecodeError` where it cannot be read. */
  receive(content: string | ArrayBuffer, nowMs: number): void {
    this.tally.bytes += typeof content === "string" ? content.length : content.byteLength;
    if (typeof content === "string") this.text(readText(content), nowMs);
    else this.poses(new DataView(content), nowMs);
  }

  draw(atMs: number, spare: Float32Array[]): Record<"main" | "other", Drawn | null> {
    return { main: this.sides.main.draw(atMs, spare), other: this.sides.other.draw(atMs, spare) };
  }

  stats(nowMs: number): Stats {
    return this.tally.tell(nowMs, this.connection, this.channels, this.sides.main.buffer.delayMs);
  }

  /** Bring the server nearer to what is wished. */
  turn(nowMs: number): void {
    if (this.state !== "live" || !this.send || !this.wish) return;
    const { wish } = this;
    const { main, other } = this.sides;
    const steered = wish.adverbs[0] ?? [];
    const now = main.channels[0]?.phase ?? Number.NaN;
    const phase = Number.isNaN(now) || this.sought !== wish.main.seek.serial ? wish.main.seek.phase : now;
    let left = MOST_SENT;
    this.pending = this.all().reduce((sum, channel) => sum + Number(channel.pending), 0);
    left -= this.bring(main.channels[0], wish.main, steered, phase, nowMs);
    if (main.channels[0]?.there) this.sought = wish.main.seek.serial;
    left -= this.bring(other.channels[0], wish.other, steered, phase, nowMs);
    this.align(nowMs);
    for (let k = main.channels.length - 1; k > 0 && left > 0; k--) {
      this.turnAt = (this.turnAt % (main.channels.length - 1)) + 1;
      const motion = this.turnAt < main.wanted ? wish.main : null;
      left -= this.bring(main.channels[this.turnAt], motion, wish.adverbs[this.turnAt] ?? steered, phase, nowMs);
    }
  }

  /** Tell a channel what it lacks, and that it is not wished where there is no motion; how many messages it took. */
  private bring(
    channel: Channel | undefined,
    motion: Motion | null,
    adverbs: readonly number[],
    phase: number,
    nowMs: number,
  ): number {
    if (!channel || (motion && !channel.there && this.pending >= MOST_PENDING)) return 0;
    const messages = motion ? channel.next(motion, adverbs, phase, nowMs) : channel.there ? [channel.close()] : [];
    for (const message of messages) this.send?.(message);
    if (messages.length > 0 && channel.pending) this.pending++;
    return messages.length;
  }

  /** Blended durations differ by method: now and then the other side is put beside the steered one again. */
  private align(nowMs: number): void {
    const [main, other] = [this.sides.main.channels[0], this.sides.other.channels[0]];
    if (!main?.settled || !other?.settled || !this.wish?.main.playing || nowMs < this.alignedMs + ALIGN_MS) return;
    const apart = other.phase - main.phase;
    if (Math.abs(apart - Math.round(apart)) < ALIGNED) return;
    this.alignedMs = nowMs;
    this.send?.(JSON.stringify({ op: "set", channel: other.number, phase: Math.min(Math.max(main.phase, 0), 1) }));
  }

  private poses(view: DataView, nowMs: number): void {
    const head = readMessageHead(view);
    const step = (head.sequence - this.sequence) >>> 0;
    if (step === 0 || step >= 2 ** 31) return;
    if (step > 1 && this.sequence > 0) this.tally.gaps++;
    this.sequence = head.sequence;
    this.lateness.add(nowMs, head.timeMs);
    let at = MESSAGE_HEAD_BYTES;
    for (let k = 0; k < head.records; k++) {
      const number = readChannel(view, at);
      const layout = this.layouts.get(number);
      if (!layout) throw new DecodeError(at, `a record of channel ${number}, which was not opened`);
      const record = readRecordHead(view, at, layout);
      for (const side of Object.values(this.sides)) {
        const channel = side.find(number);
        if (channel?.there) side.take(view, at, channel, layout, record);
      }
      at += layout.recordBytes;
    }
    this.tally.message(head.records, head.dropped);
    for (const side of Object.values(this.sides)) side.commit(head.timeMs);
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
      case "event":
        if (message.channel === 0) this.tell({ kind: "event", name: message.name, phase: message.phase });
        return;
      case "end":
        if (message.channel === 0) this.tell({ kind: "end" });
    }
  }

  private greeted(hello: { session: string; max_channels: number }, nowMs: number): void {
    this.mostChannels = hello.max_channels;
    this.lateness.clear();
    this.offered = hello.session;
    if (this.name && this.all().some((channel) => channel.there)) {
      this.tally.reconnects++;
      this.state = "joining";
      this.confirmed.clear();
      this.send?.(JSON.stringify({ op: "resume", session: this.name, last_seq: this.sequence }));
      this.barrier = this.ping(nowMs); // whatever a resume has to say comes before this comes back
    } else this.begin(nowMs);
  }

  /** A session of its own, on a clock of its own. */
  private begin(nowMs: number): void {
    this.name = this.offered;
    this.sequence = 0;
    this.barrier = -1;
    this.clock.clear();
    this.layouts.clear();
    this.tally.began();
    for (const channel of this.all()) channel.forgotten();
    for (const side of Object.values(this.sides)) side.reset();
    this.state = "live";
    this.ping(nowMs);
    this.turn(nowMs);
  }

  private opened(opened: Opened): void {
    this.layouts.set(opened.channel, layoutOf(opened.encoding, opened.joints.length, opened.record_bytes));
    this.confirmed.add(opened.channel);
    for (const side of SIDES) {
      const channel = this.sides[side].find(opened.channel);
      if (channel && this.sides[side].opened(channel, opened)) this.tell({ kind: "opened", side, opened });
    }
  }

  private pong(token: number, serverNs: number, nowMs: number): void {
    const sentMs = this.pings.get(token);
    this.pings.delete(token);
    if (sentMs !== undefined) this.clock.add(sentMs, nowMs, serverNs / 1e6);
    if (token !== this.barrier) return;
    this.barrier = -1;
    for (const channel of this.all()) if (!this.confirmed.has(channel.number)) channel.forgotten();
    this.state = "live";
    this.turn(nowMs);
  }

  private refused(number: number | null, code: string, detail: string, nowMs: number): void {
    if (code === "unknown_session" && this.state === "joining") return this.begin(nowMs);
    const side = number !== null && this.sides.other.find(number) ? "other" : "main";
    const channel = number === null ? undefined : this.sides[side].find(number);
    channel?.refused(code === "not_ready" ? nowMs + NOT_READY_MS : Number.POSITIVE_INFINITY);
    if (code !== "not_ready") this.tell({ kind: "refused", side, code, detail });
  }

  private renewed(number: number, version: number, recordBytes: number): void {
    const layout = this.layouts.get(number);
    if (layout) this.layouts.set(number, layoutOf(layout.encoding, layout.joints, recordBytes));
    const opened = number === 0 ? this.sides.main.channels[0]?.opened : null;
    if (opened) this.tell({ kind: "version", verb: opened.verb, version });
  }

  private all(): Channel[] {
    return [...this.sides.main.channels, ...this.sides.other.channels];
  }
}
