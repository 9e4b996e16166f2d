/** A stream with a socket and a server that the test plays. */

import { expect, vi } from "vitest";
import type { Opened, Verb } from "../schema.js";
import type { Figure, FigureOptions } from "./figure.js";
import type { Socket } from "./reconnector.js";
import { connect, type Stream } from "./stream.js";

export const VERB = {
  name: "reach",
  version: 1,
  adverbs: [{ name: "x" }, { name: "y" }],
  skeleton: { names: ["Hips"], parents: [-1], offsets: [[0, 0, 0]], tips: [] },
  domain: {
    chart: "identity",
    chart_axes: [0, 0, 0],
    chart_bend: [0, 0, 0, 0],
    shift: [1, 1],
    scale: [2, 2],
    middle: [0, 1],
  },
} as unknown as Verb;

export let sent: Record<string, unknown>[];
export let binary: ArrayBuffer[];
export let sockets: Socket[];
export let stream: Stream;
/** Requested descriptions. */
export let requests: number;

export const describe = async () => {
  requests++;
  return new Response(JSON.stringify(VERB), { headers: { "Content-Type": "application/json" } });
};
export const socket = () => sockets.at(-1) as unknown as WebSocket;
export const receive = (message: object) => socket().onmessage?.({ data: JSON.stringify(message) } as MessageEvent);
export const turn = () => new Promise((done) => setTimeout(done, 0));
export const ops = (op: string) => sent.filter((message) => message.op === op);

/** The server's answer to the last `open` or `switch`. */
export function answer(fields: Partial<Opened> = {}): void {
  const { channel, verb } = sent.filter(({ op }) => op === "open" || op === "switch").at(-1) as {
    channel: number;
    verb: string;
  };
  receive({
    ...{
      op: "opened",
      channel,
      verb,
      version: 1,
      method: "rbf",
      skeleton: VERB.skeleton,
      adverbs: [],
      joints: ["Hips"],
    },
    ...{ encoding: "f32", fps: 60, looping: false, resumed: false, record_bytes: 52, ...fields },
  });
}

export function opened(): Socket {
  const made = {
    ...{ binaryType: "arraybuffer", onopen: null, onmessage: null, onclose: null, close: vi.fn() },
    send: (message: string | ArrayBuffer) =>
      void (typeof message === "string" ? sent.push(JSON.parse(message)) : binary.push(message)),
  } as unknown as WebSocket;
  sockets.push(made);
  queueMicrotask(() => {
    made.onopen?.({} as Event);
    made.onmessage?.({
      data: JSON.stringify({ op: "hello", session: `s${sockets.length}`, max_channels: 3 }),
    } as MessageEvent);
  });
  return made;
}

/** The connection is lost, and another one has the server's `hello`. */
export async function reconnected(code = 1006): Promise<void> {
  vi.useFakeTimers();
  socket().onclose?.({ code, reason: "" } as CloseEvent);
  await vi.advanceTimersByTimeAsync(7000);
  vi.useRealTimers();
}

/** The server's answer to the last `ping`. */
export const pong = () =>
  receive({ op: "pong", t: sent.filter(({ op }) => op === "ping").at(-1)?.t, server_time_ns: 1 });

/** Connect to a server without sessions; returns the function that ends the test. */
export async function begin(): Promise<() => void> {
  [sent, binary, sockets] = [[], [], []];
  requests = 0;
  stream = await connect("http://server", { socket: opened, fetch: describe });
  return () => stream.close();
}

/** Open a figure that the server accepts. */
export async function open(options: FigureOptions = {}): Promise<Figure> {
  const before = ops("open").length;
  const figure = stream.open("reach", options);
  await vi.waitFor(() => expect(ops("open").length).toBeGreaterThan(before));
  answer();
  return figure;
}
