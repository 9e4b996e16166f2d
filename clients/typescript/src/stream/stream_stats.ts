/** Stream statistics. */

import type { Clock, Lateness } from "./clock.js";

/** Connection state: first attempt, open, reconnecting, or closed for good. */
export type Connection = "connecting" | "open" | "lost" | "closed";

/** Statistics of a stream: rates over the last four snapshots, and totals. */
export interface StreamStats {
  connection: Connection;
  messagesPerS: number;
  posesPerS: number;
  bytesPerS: number;
  /** Totals: frames dropped by the server, gaps in the sequence numbers, unreadable pose messages, reconnections. */
  dropped: number;
  gaps: number;
  malformed: number;
  reconnects: number;
  /** Age of pose messages on arrival, by the server's clock, ms; NaN before the first. */
  latenessP50Ms: number;
  latenessP95Ms: number;
  latenessP99Ms: number;
  roundTripMs: number;
  /** Display delay of the jitter buffer, ms. */
  bufferMs: number;
  /** Open channels. */
  channels: number;
}

/** Snapshots per rate window. */
const SNAPSHOTS = 4;

interface Counts {
  atMs: number;
  messages: number;
  poses: number;
  bytes: number;
}

export class StreamCounters {
  messages = 0;
  poses = 0;
  bytes = 0;
  gaps = 0;
  malformed = 0;
  reconnects = 0;
  private dropped = 0;
  private droppedBefore = 0;
  private past: Counts[] = [];

  constructor(
    private readonly clock: Clock,
    private readonly lateness: Lateness,
  ) {}

  /** The server counts from 0 in each session. */
  startSession(): void {
    this.droppedBefore += this.dropped;
    this.dropped = 0;
  }

  message(records: number, dropped: number): void {
    this.messages++;
    this.poses += records;
    this.dropped = dropped;
  }

  snapshot(nowMs: number, connection: Connection, channels: number, bufferMs: number): StreamStats {
    const now = { atMs: nowMs, messages: this.messages, poses: this.poses, bytes: this.bytes };
    const then = this.past[0] ?? now;
    this.past = [...this.past, now].slice(-SNAPSHOTS);
    const seconds = Math.max((now.atMs - then.atMs) / 1000, 1e-3);
    const age = (quantile: number) => this.lateness.transit(quantile) + this.clock.offsetMs;
    return {
      connection,
      messagesPerS: (now.messages - then.messages) / seconds,
      posesPerS: (now.poses - then.poses) / seconds,
      bytesPerS: (now.bytes - then.bytes) / seconds,
      dropped: this.droppedBefore + this.dropped,
      gaps: this.gaps,
      malformed: this.malformed,
      reconnects: this.reconnects,
      latenessP50Ms: age(0.5),
      latenessP95Ms: age(0.95),
      latenessP99Ms: age(0.99),
      roundTripMs: this.clock.roundTripMs,
      bufferMs,
      channels,
    };
  }
}
