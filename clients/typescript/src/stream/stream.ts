/** A stream of figures: one connection, kept up, with any number of characters. */

import { Emitter } from "../emitter.js";
import { type AdverbError, NoAccess, responseError, StreamClosed, TimedOut, TransportError } from "../errors.js";
import { Evaluators } from "../evaluator/evaluators.js";
import { Client, type ClientOptions } from "../rest/client.js";
import type { BudgetReport, Opened, Verb } from "../schema.js";
import { viewMessage } from "../wire/client_messages.js";
import { type Goal, writeAdverbs, writeBulkAdverbs } from "../wire/decode.js";
import { Figure, type FigureOptions } from "./figure.js";
import { Link, now } from "./link.js";
import { NodeSocket, nodeSocketsExist } from "./node_socket.js";
import { Protocol, type ProtocolEvents } from "./protocol.js";
import type { Socket } from "./reconnector.js";
import type { Connection, StreamStats } from "./stream_stats.js";

/** Limit of unanswered `open` messages; the server queues at most 256 messages. */
const MOST_PENDING = 48;
const NOT_READY_MS = 1000;
const CHANNELS = 65_536;
/** Failed attempts to connect after which the key is checked. */
const CHECK_KEY_AFTER = 3;

export interface ConnectOptions extends Pick<ClientOptions, "key" | "fetch"> {
  /** Time in which the server has to answer, ms (10,000). */
  timeoutMs?: number;
  /** Opens a socket with subprotocols; by default the platform's `WebSocket`, and an own client in Node 20. */
  socket?: (address: string, protocols: string[]) => Socket;
}

export interface StreamEvents {
  /** The connection was lost or is open again; `againInS`: time until the next attempt. */
  connection: { connection: Connection; detail: string; againInS: number };
  /** The key is not valid any more; the stream waits for `setKey`. */
  unauthenticated: { detail: string };
  /** A figure passed a keytime. */
  keytime: { figure: Figure; name: string; phase: number };
  /** The motion of a figure is at its end and does not loop. */
  end: { figure: Figure };
  /** A figure has another version of its verb. */
  version: { figure: Figure; version: number };
  /** The server rejected a message. */
  error: AdverbError;
  /** Once a second while there is a byte budget. */
  budget: BudgetReport;
  /** The server is about to stop. */
  drain: { detail: string; reconnectAfterS: number };
}

/**
 * Connect to a server, with further attempts until `timeoutMs`. A connection that is lost later is opened again, without
 * a limit of time.
 *
 * @param server address, such as `http://127.0.0.1:8000`; empty: the server of this page
 * @throws TransportError the server cannot be reached
 * @throws TimedOut it does not answer in time
 * @throws NoAccess it needs a key, or another one
 */
export async function connect(server = "", options: ConnectOptions = {}): Promise<Stream> {
  const stream = new Stream(server, options);
  const { timeoutMs = 10_000 } = options;
  const stops: (() => void)[] = [];
  try {
    await new Promise<void>((done, failed) => {
      let lost: TransportError | null = null;
      const late = () => failed(lost ?? new TimedOut(`no answer after ${timeoutMs / 1000} s`));
      const timer = setTimeout(late, timeoutMs);
      const refused = (reason: AdverbError) => reason instanceof NoAccess && failed(reason);
      stops.push(
        () => clearTimeout(timer),
        stream.on("unauthenticated", ({ detail }) => failed(new NoAccess(401, "unauthenticated", detail))),
        stream.on("connection", ({ connection, detail }) => {
          if (connection === "open") return done();
          lost = new TransportError(detail);
          void reasonOf(lost, stream.client, timeoutMs).then(refused);
        }),
      );
    });
  } catch (err) {
    stream.close();
    throw err;
  } finally {
    for (const stop of stops) stop();
  }
  return stream;
}

/** The reason of a refused handshake, which sockets do not report: the key, or its scope; else the given one. */
async function reasonOf(err: TransportError, client: Client, timeoutMs: number): Promise<AdverbError> {
  try {
    const { scopes, required } = await client.access(AbortSignal.timeout(timeoutMs));
    if (!required || scopes.includes("pose") || scopes.includes("admin")) return err;
    const detail = `a stream needs a key with the scope 'pose'; yours has ${scopes.join(", ") || "none"}`;
    return new NoAccess(403, "missing_scope", detail, [], 0, { scope: "pose" });
  } catch (reason) {
    return reason instanceof NoAccess ? reason : err;
  }
}

/** Open a socket: the platform's, or an own client in Node without one. */
function openSocket(address: string, protocols: string[]): Socket {
  if (typeof WebSocket === "undefined" && nodeSocketsExist()) return new NodeSocket(address, protocols) as Socket;
  return new WebSocket(address, protocols);
}

export class Stream {
  /** REST calls to the same server. */
  readonly client: Client;
  private readonly evaluators: Evaluators;
  private readonly figures = new Map<number, Figure>();
  private readonly emitter = new Emitter<StreamEvents>();
  private readonly protocol: Protocol;
  private readonly link: Link;
  private readonly descriptions = new Map<string, Promise<Verb>>();
  private readonly timeoutMs: number;
  /** Failed attempts to connect since the connection was lost. */
  private attempts = 0;
  private nextChannel = 0;
  private scheduled = false;
  private shownView: string | null = null;
  private closed = false;

  /** Use `connect`, which waits until the server has answered. */
  constructor(server: string, { key = null, timeoutMs = 10_000, socket = openSocket, fetch }: ConnectOptions) {
    this.client = new Client(server || globalThis.location?.origin || "", { key, fetch });
    this.evaluators = new Evaluators(this.client, () => {
      for (const figure of this.figures.values()) figure.arrived();
    });
    this.timeoutMs = timeoutMs;
    const address = `${this.client.base.replace(/^http/, "ws")}/v1/stream`;
    this.protocol = new Protocol(this.receiver());
    this.link = new Link((protocols) => socket(address, protocols), this.protocol, {
      connection: (connection, detail, againInS) => {
        this.emitter.emit("connection", { connection, detail, againInS });
        if (connection === "open") this.attempts = 0;
        else if (connection === "lost" && ++this.attempts % CHECK_KEY_AFTER === 0) void this.checkKey();
      },
      unauthenticated: (_, detail) => this.emitter.emit("unauthenticated", { detail }),
    });
    this.link.setKey(key ?? "");
  }

  get connection(): Connection {
    return this.closed ? "closed" : this.protocol.connection;
  }

  /** Call `then` at an event; returns the unsubscribe function. */
  on<Name extends keyof StreamEvents>(event: Name, then: (event: StreamEvents[Name]) => void): () => void {
    return this.emitter.on(event, then);
  }

  /**
   * Open a figure.
   *
   * @throws UnknownName no verb, adverb or method of this name
   * @throws ResponseError the server rejects the request for another reason
   */
  async open(verb: string, options: FigureOptions = {}): Promise<Figure> {
    const description = await this.describe(verb);
    if (this.closed) throw new StreamClosed("the stream is closed");
    if (this.figures.size >= this.protocol.maxChannels)
      throw responseError(0, "too_many_channels", `a stream has at most ${this.protocol.maxChannels} figures`);
    const host = {
      changed: () => this.schedule(),
      send: (message: string) => this.protocol.send(message),
      describe: (name: string) => this.describe(name),
      closed: () => this.figures.delete(figure.channel.number),
    };
    const { lateness } = this.protocol;
    const figure = new Figure(this.freeChannel(), description, options, lateness, host, this.evaluators);
    this.figures.set(figure.channel.number, figure);
    this.schedule();
    await figure.answered;
    return figure;
  }

  /**
   * Viewpoint and byte budget of the connection: near and important figures are sent more often.
   *
   * @param position m, +Y up; null: no viewpoint
   * @param budgetKbps limit of pose messages, 1000 bit/s; null: unlimited
   */
  view(position: readonly [number, number, number] | null, budgetKbps: number | null = null): void {
    this.shownView = viewMessage(position, budgetKbps);
    this.protocol.send(this.shownView);
  }

  /** Connect with another key, which the REST calls have too; null: disconnect until there is one. */
  setKey(key: string | null): void {
    this.client.key = key;
    this.link.setKey(key);
  }

  /** Sockets do not report why a handshake is refused: with a key that was revoked, the attempts end. */
  private async checkKey(): Promise<void> {
    const { key } = this.client;
    const reason = await reasonOf(new TransportError(""), this.client, this.timeoutMs);
    if (!(reason instanceof NoAccess) || this.connection !== "lost" || this.client.key !== key) return;
    this.link.setKey(null);
    this.emitter.emit("unauthenticated", { detail: reason.detail });
  }

  /** Rates since the last calls, and totals. */
  stats(): StreamStats {
    const delays = [...this.figures.values()].map(({ delayMs }) => delayMs);
    return this.protocol.stats(now(), Math.max(0, ...delays));
  }

  /** Close all figures and the connection. */
  close(): void {
    if (this.closed) return;
    this.closed = true;
    this.link.stop();
    for (const figure of this.figures.values()) figure.end(new StreamClosed("the stream is closed"));
    this.figures.clear();
  }

  /** Description of a verb, requested once; a server that is still loading is given time. */
  private describe(verb: string): Promise<Verb> {
    const known = this.descriptions.get(verb);
    if (known) return known;
    const found = this.request(verb);
    this.descriptions.set(verb, found);
    found.catch(() => this.descriptions.delete(verb));
    return found;
  }

  private async request(verb: string): Promise<Verb> {
    const end = now() + this.timeoutMs;
    for (;;) {
      try {
        const { timeoutMs } = this;
        return await this.client.call("get", "/v1/verbs/{verb}", { path: { verb }, timeoutMs });
      } catch (err) {
        if ((err as AdverbError).code !== "not_ready" || now() > end) throw err;
        await new Promise((done) => setTimeout(done, NOT_READY_MS));
      }
    }
  }

  private freeChannel(): number {
    while (this.figures.has(this.nextChannel)) this.nextChannel = (this.nextChannel + 1) % CHANNELS;
    const found = this.nextChannel;
    this.nextChannel = (this.nextChannel + 1) % CHANNELS;
    return found;
  }

  /** Send the changes of this turn of the event loop together. */
  private schedule(): void {
    if (this.scheduled) return;
    this.scheduled = true;
    queueMicrotask(() => {
      this.scheduled = false;
      this.step();
    });
  }

  private step(): void {
    if (!this.protocol.live) return;
    const goals: Goal[] = [];
    let pending = [...this.figures.values()].filter(({ channel }) => channel.pending).length;
    for (const figure of this.figures.values()) {
      if (!figure.channel.isOpen && pending >= MOST_PENDING) continue;
      const waited = figure.channel.pending;
      for (const message of figure.next(now())) {
        if (typeof message === "string") this.protocol.send(message);
        else goals.push(message);
      }
      if (!waited && figure.channel.pending) pending++;
    }
    const [first, ...others] = goals;
    if (!first) return;
    const messages = others.length > 0 ? writeBulkAdverbs(goals) : [writeAdverbs(first.channel, first.adverbs)];
    for (const message of messages) this.protocol.send(message);
  }

  private receiver(): ProtocolEvents {
    const { figures, emitter } = this;
    const figureOf = (channel: number, then: (figure: Figure) => void) => {
      const figure = figures.get(channel);
      if (figure) then(figure);
    };
    return {
      get openChannels() {
        return [...figures.values()].filter(({ channel }) => channel.isOpen).length;
      },
      started: () => {
        this.descriptions.clear();
        for (const figure of figures.values()) figure.forget();
        if (this.shownView) this.protocol.send(this.shownView);
        this.step();
      },
      resumed: (channels) => {
        for (const figure of figures.values()) if (!channels.has(figure.channel.number)) figure.channel.forget();
        for (const channel of channels) // closed while the connection was lost
          if (!figures.has(channel)) this.protocol.send(JSON.stringify({ op: "close", channel }));
        this.step();
      },
      opened: (opened: Opened) => {
        figureOf(opened.channel, (figure) => figure.opened(opened));
        this.schedule();
      },
      rejected: (channel, code, detail, nowMs) => this.rejected(channel, code, detail, nowMs),
      record: (view, at, layout, head) =>
        figureOf(head.channel, (figure) => {
          if (figure.channel.isOpen) figure.record(view, at, layout, head);
        }),
      tick: (dueMs) => {
        for (const figure of figures.values()) figure.tick(dueMs);
      },
      version: (channel, version) =>
        figureOf(channel, (figure) => {
          this.descriptions.delete(figure.verb.name);
          emitter.emit("version", { figure, version });
        }),
      keytime: (channel, name, phase) =>
        figureOf(channel, (figure) => emitter.emit("keytime", { figure, name, phase })),
      ended: (channel) => figureOf(channel, (figure) => emitter.emit("end", { figure })),
      budget: (report) => emitter.emit("budget", report),
      draining: (detail, reconnectAfterS) => emitter.emit("drain", { detail, reconnectAfterS }),
    };
  }

  private rejected(channel: number | null, code: string, detail: string, nowMs: number): void {
    const figure = channel === null ? undefined : this.figures.get(channel);
    if (figure?.channel.pending && !figure.channel.answers(code)) return;
    if (figure && code === "channel_in_use") {
      figure.channel.refused(code, nowMs);
      return this.schedule();
    }
    if (code === "not_ready" && figure) {
      figure.channel.refused(code, nowMs + NOT_READY_MS);
      setTimeout(() => this.schedule(), NOT_READY_MS + 1);
      return;
    }
    const error = responseError(0, code, detail, [], 0, { channel });
    if (!figure?.channel.pending) return this.emitter.emit("error", error);
    figure.channel.refused(code, Number.POSITIVE_INFINITY);
    if (!figure.refuse(error)) this.emitter.emit("error", error); // it was open in an earlier session
    if (figure.channel.isOpen || figure.switching) return; // a refused switch continues with the verb before
    this.figures.delete(figure.channel.number);
    figure.end(error);
  }
}
