/** Keeps a stream's socket connected, with growing pauses, and disconnected while a key is needed. */

const SUBPROTOCOL = "adverb.v1";
/** Prefix of the subprotocol that carries the key. */
const BEARER = "adverb.bearer.";
const KEY_NOT_VALID = 4401;
const TOO_MANY_STREAMS = 4029;
const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 8000;

/** The part of `WebSocket` that is used; replaced in tests. */
export type Socket = Pick<WebSocket, "binaryType" | "onopen" | "onmessage" | "onclose" | "send" | "close">;

export interface SocketEvents {
  opened(send: (message: string | ArrayBuffer) => void): void;
  received(data: string | ArrayBuffer): void;
  /** `againInS` is the time until the next attempt. */
  lost(detail: string, againInS: number): void;
  /** The server closed the stream of this key; there is no further attempt until `setKey`. */
  unauthenticated(key: string, detail: string): void;
}

export class Reconnector {
  private socket: Socket | null = null;
  private key: string | null = null;
  private failures = 0;
  private startedMs = 0;
  /** Shortest pause after the next loss, ms. */
  leastPauseMs = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly open: (protocols: string[]) => Socket,
    private readonly events: SocketEvents,
  ) {}

  get connected(): boolean {
    return this.socket !== null;
  }

  /** Time since the attempt to connect began, ms. */
  get ageMs(): number {
    return performance.now() - this.startedMs;
  }

  /** Connect with a key, empty for none; null: disconnect until there is one. */
  setKey(key: string | null): void {
    if (key === this.key && this.socket) return;
    const had = this.socket;
    this.drop();
    this.key = key;
    this.failures = 0;
    if (had) this.events.lost(key === null ? "a key is needed" : "the key was changed", 0);
    if (key !== null) this.connect();
  }

  /** The stream works: the next pause is the shortest. */
  succeed(): void {
    this.failures = 0;
  }

  /** Give up the socket, and connect again after a pause. */
  fail(detail: string): void {
    if (!this.socket) return;
    this.drop();
    const grownMs = Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** this.failures++) * (0.5 + Math.random() / 2);
    const pauseMs = Math.max(this.leastPauseMs, grownMs);
    this.leastPauseMs = 0;
    this.events.lost(detail, pauseMs / 1000);
    this.timer = setTimeout(() => this.connect(), pauseMs);
  }

  stop(): void {
    clearTimeout(this.timer);
    this.socket?.close(1000);
    this.socket = null;
  }

  private connect(): void {
    const { key } = this;
    this.startedMs = performance.now();
    const opened = this.open(key ? [SUBPROTOCOL, BEARER + key] : [SUBPROTOCOL]);
    this.socket = opened;
    opened.binaryType = "arraybuffer";
    opened.onopen = () => this.socket === opened && this.events.opened((message) => opened.send(message));
    opened.onmessage = ({ data }) => this.socket === opened && this.events.received(data);
    opened.onclose = ({ code, reason }) => {
      if (this.socket === opened) this.closed(code, reason || `connection closed (${code})`);
    };
  }

  private closed(code: number, detail: string): void {
    if (code !== KEY_NOT_VALID) {
      if (code === TOO_MANY_STREAMS) this.failures = Number.POSITIVE_INFINITY; // the longest pause
      return this.fail(detail);
    }
    this.drop();
    this.events.lost(detail, 0);
    this.events.unauthenticated(this.key ?? "", detail);
  }

  private drop(): void {
    clearTimeout(this.timer);
    const { socket } = this;
    this.socket = null;
    socket?.close();
  }
}
