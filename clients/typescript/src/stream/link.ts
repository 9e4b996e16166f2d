/** A protocol on a socket that is kept connected: messages, heartbeat, reconnection. */

import { DecodeError } from "../errors.js";
import type { Protocol } from "./protocol.js";
import { Reconnector, type Socket } from "./reconnector.js";
import type { Connection } from "./stream_stats.js";

const PING_MS = 1000;
const SILENT_MS = 8000;
/** Longest pause that a server can request. */
const MOST_DRAIN_S = 60;

export interface LinkEvents {
  /** The state changed; `againInS` is the time until the next attempt to connect. */
  connection(connection: Connection, detail: string, againInS: number): void;
  /** The server closed the stream of this key; there is no further attempt until `setKey`. */
  unauthenticated(key: string, detail: string): void;
}

/** Monotone time in ms since 1970, equal in a page and its workers. */
export function now(): number {
  return performance.timeOrigin + performance.now();
}

export class Link {
  private readonly sockets: Reconnector;
  private readonly timer: ReturnType<typeof setInterval>;

  /** @param open opens a socket with subprotocols */
  constructor(
    open: (protocols: string[]) => Socket,
    private readonly protocol: Protocol,
    private readonly events: LinkEvents,
  ) {
    this.sockets = new Reconnector(open, {
      opened: (send) => protocol.attach(send),
      received: (data) => this.received(data),
      lost: (detail, againInS) => {
        protocol.lost();
        events.connection(protocol.connection, detail, againInS);
      },
      unauthenticated: (key, detail) => events.unauthenticated(key, detail),
    });
    this.timer = setInterval(() => this.heartbeat(), PING_MS);
  }

  /** Connect with a key, empty for none; null: disconnect until there is one. */
  setKey(key: string | null): void {
    this.sockets.setKey(key);
  }

  /** Close the connection for good. */
  stop(): void {
    clearInterval(this.timer);
    this.sockets.stop();
    this.protocol.lost();
    this.events.connection("closed", "", 0);
  }

  private received(data: string | ArrayBuffer): void {
    const before = this.protocol.connection;
    try {
      this.protocol.receive(data, now());
    } catch (err) {
      if (!(err instanceof DecodeError)) throw err;
      if (typeof data !== "string") return void this.protocol.counters.malformed++;
      return this.sockets.fail(err.message); // the channels are in doubt
    }
    this.sockets.leastPauseMs = 1000 * Math.min(this.protocol.drainS, MOST_DRAIN_S);
    if (this.protocol.connection === "open" && before !== "open") {
      this.sockets.succeed();
      this.events.connection("open", "", 0);
    }
  }

  private heartbeat(): void {
    const { sockets, protocol } = this;
    if (sockets.connected && protocol.silent(now(), SILENT_MS))
      sockets.fail(`no answer to a ping for ${SILENT_MS / 1000} s`);
    else if (protocol.connection === "open") protocol.ping(now());
    else if (sockets.connected && !protocol.answered && sockets.ageMs > SILENT_MS)
      sockets.fail(`no session after ${SILENT_MS / 1000} s`);
  }
}
