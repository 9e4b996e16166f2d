/** Stream statistics, reported four times per second. */

import type { Connection, Stats } from "../types";
import type { Clock, Lateness } from "./clock";

/** Snapshots per rate window of one second. */
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

  snapshot(nowMs: number, connection: Connection, channels: number, bufferMs: number): Stats {
    const now = { atMs: nowMs, messages: this.messages, poses: this.poses, bytes: this.bytes };
    const then = this.past[0] ?? now;
    this.past = [...this.past, now].slice(-SNAPSHOTS);
    const seconds = Math.max((now.atMs - then.atMs) / 1000, 1e-3);
    const age = (quantile: number) => this.lateness.transit(quantile) + this.clock.offsetMs;
    return {
      connection,
      messages_per_s: (now.messages - then.messages) / seconds,
      poses_per_s: (now.poses - then.poses) / seconds,
      bytes_per_s: (now.bytes - then.bytes) / seconds,
      dropped: this.droppedBefore + this.dropped,
      gaps: this.gaps,
      reconnects: this.reconnects,
      lateness_p50_ms: age(0.5),
      lateness_p95_ms: age(0.95),
      lateness_p99_ms: age(0.99),
      round_trip_ms: this.clock.roundTripMs,
      buffer_ms: bufferMs,
      channels,
    };
  }
}
