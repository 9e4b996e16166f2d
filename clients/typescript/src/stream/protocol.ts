/**
 * Protocol of a stream without its socket: session, resume, clock, record layouts, sequence numbers.
 *
 * What the channels are for is decided by its events' receiver: one figure, or a crowd.
 */

import { DecodeError } from "../errors.js";
import type { BudgetReport, Opened } from "../schema.js";
import {
  checkEnd,
  type Layout,
  layoutOf,
  MESSAGE_HEAD_BYTES,
  type RecordHead,
  readChannel,
  readMessageHead,
  readRecordHead,
} from "../wire/decode.js";
import { readText, type ServerMessage } from "../wire/server_messages.js";
import { Clock, Lateness } from "./clock.js";
import { type Connection, StreamCounters, type StreamStats } from "./stream_stats.js";

/** Text (JSON) or binary message. */
export type Message = string | ArrayBuffer;

/** Receiver of what arrives on a stream. */
export interface ProtocolEvents {
  /** Number of channels that the server has, as far as known; without any, no session is resumed. */
  readonly openChannels: number;
  /** A new session begins, in which the server has no channel. */
  started(nowMs: number): void;
  /** The session was resumed with these channels; others do not exist any more. */
  resumed(channels: ReadonlySet<number>, nowMs: number): void;
  opened(opened: Opened): void;
  /** An error of a channel, or of none (null). */
  rejected(channel: number | null, code: string, detail: string, nowMs: number): void;
  /** A record of an open channel, at a byte offset of a message. */
  record(view: DataView, at: number, layout: Layout, head: RecordHead): void;
  /** All records of a message were read; its due time on the server's clock. */
  tick(dueMs: number): void;
  version(channel: number, version: number): void;
  keytime(channel: number, name: string, phase: number): void;
  ended(channel: number): void;
  budget?(report: BudgetReport): void;
  draining?(detail: string, reconnectAfterS: number): void;
}

export class Protocol {
  readonly clock = new Clock();
  readonly counters: StreamCounters;
  /** Limit of channels, from `hello`. */
  maxChannels = 1024;
  /** Pause before a reconnection that the server has requested on this connection, s. */
  drainS = 0;
  private sender: ((message: Message) => void) | null = null;
  /** Away: no session. Joining: a resume is being answered. */
  private state: "away" | "joining" | "live" = "away";
  private session = "";
  private sequence = 0;
  private readonly pings = new Map<number, number>();
  private token = 0;
  private barrier = -1;
  /** Session offered on this connection; used if there is none to resume. */
  private offeredSession = "";
  private readonly confirmed = new Set<number>();
  /** Record layouts by channel, including closed channels whose records may still arrive. */
  private readonly layouts = new Map<number, Layout>();

  constructor(
    private readonly events: ProtocolEvents,
    readonly lateness = new Lateness(),
  ) {
    this.counters = new StreamCounters(this.clock, lateness);
  }

  get connection(): Connection {
    return this.state === "live" ? "open" : this.session ? "lost" : "connecting";
  }

  get live(): boolean {
    return this.state === "live" && this.sender !== null;
  }

  /** Whether this connection has had its `hello`. */
  get answered(): boolean {
    return this.state !== "away";
  }

  /** Send a message, if a session is live. */
  send(message: Message): void {
    if (this.live) this.sender?.(message);
  }

  /** A socket is open; the server sends the first message. */
  attach(send: (message: Message) => void): void {
    this.sender = send;
  }

  /** The socket is gone. */
  lost(): void {
    this.sender = null;
    this.state = "away";
    this.drainS = 0;
    this.pings.clear();
  }

  /** Whether a ping has been unanswered for longer than `mostMs`. */
  silent(nowMs: number, mostMs: number): boolean {
    const oldest = this.pings.values().next().value;
    return oldest !== undefined && nowMs - oldest > mostMs;
  }

  ping(nowMs: number): number {
    this.pings.set(++this.token, nowMs);
    this.sender?.(JSON.stringify({ op: "ping", t: this.token }));
    return this.token;
  }

  /** Handle a message; throws `DecodeError` if it is unreadable. */
  receive(content: Message, nowMs: number): void {
    this.counters.bytes += typeof content === "string" ? content.length : content.byteLength;
    if (typeof content === "string") this.text(readText(content), nowMs);
    else this.poses(new DataView(content), nowMs);
  }

  /** Statistics; `bufferMs` is the display delay. */
  stats(nowMs: number, bufferMs: number): StreamStats {
    return this.counters.snapshot(nowMs, this.connection, this.events.openChannels, bufferMs);
  }

  private poses(view: DataView, nowMs: number): void {
    const head = readMessageHead(view);
    const step = (head.sequence - this.sequence) >>> 0;
    if (step === 0 || step >= 2 ** 31) return;
    const records = this.records(view, head.records);
    if (step > 1 && this.sequence > 0) this.counters.gaps++;
    this.sequence = head.sequence;
    this.lateness.add(nowMs, head.timeMs);
    for (const [at, layout, record] of records) this.events.record(view, at, layout, record);
    this.counters.message(head.records, head.dropped);
    this.events.tick(head.timeMs);
  }

  /** Byte offset, layout and head of each record; their sizes fit the message. */
  private records(view: DataView, count: number): [number, Layout, RecordHead][] {
    const records: [number, Layout, RecordHead][] = [];
    let at = MESSAGE_HEAD_BYTES;
    for (let k = 0; k < count; k++) {
      const number = readChannel(view, at);
      const layout = this.layouts.get(number);
      if (!layout) throw new DecodeError(at, `a record of channel ${number}, which was not opened`);
      records.push([at, layout, readRecordHead(view, at, layout)]);
      at += layout.recordBytes;
    }
    checkEnd(view, at);
    return records;
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
        return this.rejected(message.channel, message.code, message.detail, nowMs);
      case "version":
        return this.renewed(message.channel, message.version, message.record_bytes);
      case "events":
        for (const { channel, name, phase } of message.items) this.events.keytime(channel, name, phase);
        return;
      case "end":
        return this.events.ended(message.channel);
      case "stats":
        return this.events.budget?.(message);
      case "drain":
        this.drainS = message.reconnect_after_s;
        return this.events.draining?.(message.detail, message.reconnect_after_s);
    }
  }

  private greeted(hello: { session: string; max_channels: number }, nowMs: number): void {
    this.maxChannels = hello.max_channels;
    this.lateness.clear();
    this.offeredSession = hello.session;
    if (!this.session || this.events.openChannels === 0) return this.begin(nowMs);
    this.counters.reconnects++;
    this.state = "joining";
    this.confirmed.clear();
    this.sender?.(JSON.stringify({ op: "resume", session: this.session, last_seq: this.sequence }));
    this.barrier = this.ping(nowMs); // all answers to the resume precede this pong
  }

  /** Start a new session with a new clock. */
  private begin(nowMs: number): void {
    this.session = this.offeredSession;
    this.sequence = 0;
    this.barrier = -1;
    this.clock.clear();
    this.layouts.clear();
    this.counters.startSession();
    this.state = "live";
    this.ping(nowMs);
    this.events.started(nowMs);
  }

  private opened(opened: Opened): void {
    this.layouts.set(opened.channel, layoutOf(opened.encoding, opened.joints.length, opened.record_bytes));
    this.confirmed.add(opened.channel);
    this.events.opened(opened);
  }

  private pong(token: number, serverNs: number, nowMs: number): void {
    const sentMs = this.pings.get(token);
    this.pings.delete(token);
    if (sentMs !== undefined) this.clock.add(sentMs, nowMs, serverNs / 1e6);
    if (token !== this.barrier) return;
    this.barrier = -1;
    this.state = "live";
    this.events.resumed(this.confirmed, nowMs);
  }

  private rejected(channel: number | null, code: string, detail: string, nowMs: number): void {
    if (code === "unknown_session" && this.state === "joining") return this.begin(nowMs);
    this.events.rejected(channel, code, detail, nowMs);
  }

  private renewed(channel: number, version: number, recordBytes: number): void {
    const layout = this.layouts.get(channel);
    if (layout) this.layouts.set(channel, layoutOf(layout.encoding, layout.joints, recordBytes));
    this.events.version(channel, version);
  }
}
