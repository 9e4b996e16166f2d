/** Messages of a stream, with a socket and a server that the test plays. */

import { beforeEach, expect, test, vi } from "vitest";
import { BadRequest, ChannelError, StreamClosed, TimedOut } from "../errors.js";
import type { Opened, Verb } from "../schema.js";
import { writeAdverbs, writeBulkAdverbs } from "../wire/decode.js";
import type { FigureOptions } from "./figure.js";
import type { Socket } from "./reconnector.js";
import { connect, type Stream } from "./stream.js";

const VERB = {
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

let sent: Record<string, unknown>[];
let binary: ArrayBuffer[];
let sockets: Socket[];
let stream: Stream;

const socket = () => sockets.at(-1) as unknown as WebSocket;
const receive = (message: object) => socket().onmessage?.({ data: JSON.stringify(message) } as MessageEvent);
const turn = () => new Promise((done) => setTimeout(done, 0));
const ops = (op: string) => sent.filter((message) => message.op === op);

/** The server's answer to the last `open` or `switch`. */
function answer(fields: Partial<Opened> = {}): void {
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

function opened(): Socket {
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
async function reconnected(code = 1006): Promise<void> {
  vi.useFakeTimers();
  socket().onclose?.({ code, reason: "" } as CloseEvent);
  await vi.advanceTimersByTimeAsync(7000);
  vi.useRealTimers();
}

/** The server's answer to the last `ping`. */
const pong = () => receive({ op: "pong", t: sent.filter(({ op }) => op === "ping").at(-1)?.t, server_time_ns: 1 });

beforeEach(async () => {
  [sent, binary, sockets] = [[], [], []];
  const fetch = async () => new Response(JSON.stringify(VERB), { headers: { "Content-Type": "application/json" } });
  stream = await connect("http://server", { socket: opened, fetch });
  return () => stream.close();
});

async function open(options = {}) {
  const before = ops("open").length;
  const figure = stream.open("reach", options);
  await vi.waitFor(() => expect(ops("open").length).toBeGreaterThan(before));
  answer();
  return figure;
}

test("a figure is opened with all adverbs: those that are not given are in the middle of the domain", async () => {
  await open({ adverbs: { x: 0.3 }, plant: false, method: "rbf" });
  expect(ops("open")).toMatchObject([
    { channel: 0, verb: "reach", adverbs: { x: 0.3, y: 1.5 }, fps: 60, plant: false, method: "rbf", phase: 0 },
  ]);
  expect(ops("open")[0]).not.toHaveProperty("loop");
});

test("a description that does not arrive in time is an error of open, and is requested again", async () => {
  let requests = 0;
  const silent = (_: unknown, init?: RequestInit) =>
    new Promise<Response>((_, failed) => {
      requests++;
      init?.signal?.addEventListener("abort", () => failed(init.signal?.reason));
    });
  const other = await connect("http://server", { socket: opened, fetch: silent as typeof fetch, timeoutMs: 50 });
  for (let k = 0; k < 2; k++) await expect(other.open("reach")).rejects.toBeInstanceOf(TimedOut);
  expect(requests).toBe(2);
  other.close();
});

test("changes of one turn are one message of each kind", async () => {
  const figure = await open();
  sent.length = 0;
  figure.aim({ x: 1 });
  figure.set({ speed: 2, adverbs: { y: 2 } });
  figure.set({ playing: false, phase: 0.5, speed: 3 });
  await turn();
  expect(sent).toEqual([{ op: "set", channel: 0, speed: 3, play: false, phase: 0.5 }]);
  expect(binary).toEqual([writeAdverbs(0, [1, 2])]);
});

test("goals of several figures are one message", async () => {
  const first = await open();
  const second = stream.open("reach");
  await vi.waitFor(() => expect(ops("open")).toHaveLength(2));
  answer();
  first.aim({ x: 1 });
  (await second).aim({ x: 2 });
  await turn();
  const rows = [0, 1].map((channel) => ({ channel, adverbs: [channel + 1, 1.5] }));
  expect(binary).toEqual(writeBulkAdverbs(rows));
});

test("a rejected open is an error, and its channel is free", async () => {
  const wrong = stream.open("reach", { method: "magic" });
  await vi.waitFor(() => expect(ops("open")).toHaveLength(1));
  receive({ op: "error", channel: 0, code: "unknown_method", detail: "unknown method magic" });
  await expect(wrong).rejects.toMatchObject({ code: "unknown_method", channel: 0 });
  expect(stream.stats().channels).toBe(0);
});

test("a rejected switch keeps the verb, and the next setting is sent", async () => {
  const figure = await open({ adverbs: { x: 0.3 } });
  const other = figure.switch("arm3");
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  receive({ op: "error", channel: 0, code: "skeleton_mismatch", detail: "no" });
  await expect(other).rejects.toBeInstanceOf(ChannelError);
  expect(figure.goal).toEqual({ x: 0.3, y: 1.5 });
  figure.set({ speed: 2 });
  await turn();
  expect(ops("switch")).toHaveLength(1);
  expect(ops("set")).toEqual([{ op: "set", channel: 0, speed: 2 }]);
});

test("a switch to the same verb is sent, also after a refusal", async () => {
  const figure = await open();
  for (const [k, code] of ["", "out_of_range", ""].entries()) {
    const other = figure.switch("reach", { adverbs: { x: k } });
    await vi.waitFor(() => expect(ops("switch")).toHaveLength(k + 1));
    if (code) receive({ op: "error", channel: 0, code, detail: "no" });
    else answer();
    if (code) await expect(other).rejects.toMatchObject({ code });
    else await other;
  }
  expect(figure.goal).toEqual({ x: 2, y: 1.5 });
});

test("switches follow one another, and each is settled", async () => {
  const figure = await open();
  const settled: string[] = [];
  const then = (name: string) => () => settled.push(name);
  const both = [
    figure.switch("arm3").then(then("first"), then("refused")),
    figure.switch("punch").then(then("second"), then("refused")),
  ];
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  answer();
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(2));
  expect(settled).toEqual(["first"]);
  answer();
  await Promise.all(both);
  expect(settled).toEqual(["first", "second"]);
  expect(ops("switch").map(({ verb }) => verb)).toEqual(["arm3", "punch"]);
});

test("a figure that is closed has no pending promise", async () => {
  const figure = await open();
  const pending = [figure.switch("arm3"), figure.switch("punch"), figure.first()];
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  figure.close();
  for (const each of [...pending, figure.first(), figure.switch("arm3")])
    await expect(each).rejects.toBeInstanceOf(StreamClosed);
  const other = await open();
  const first = other.first();
  stream.close();
  await expect(first).rejects.toBeInstanceOf(StreamClosed);
});

test("settings that change during a refused switch remain", async () => {
  const figure = await open({ loop: true, adverbs: { x: 0.3 } });
  const other = figure.switch("arm3");
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  figure.set({ speed: 0.25, playing: false });
  receive({ op: "error", channel: 0, code: "skeleton_mismatch", detail: "no" });
  await expect(other).rejects.toBeInstanceOf(ChannelError);
  await turn();
  expect(ops("set")).toEqual([{ op: "set", channel: 0, speed: 0.25, play: false }]);
  expect(figure.goal).toEqual({ x: 0.3, y: 1.5 });
});

test("a switch whose message was lost is sent again after a resume, and settled by its answer", async () => {
  const figure = await open();
  let settled = false;
  const other = figure.switch("arm3").then(() => {
    settled = true;
  });
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  await reconnected();
  answer({ resumed: true, verb: "reach" });
  pong();
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(2));
  await turn();
  expect(settled).toBe(false);
  answer();
  await other;
});

test("an error without a request is an event", async () => {
  const figure = await open();
  const codes: string[] = [];
  stream.on("error", ({ code }) => codes.push(code));
  figure.set({ fps: 500 });
  await turn();
  receive({ op: "error", channel: 0, code: "bad_message", detail: "fps" });
  expect(codes).toEqual(["bad_message"]);
});

test("an error of a listener is thrown outside, and the connection and the other listeners remain", async () => {
  await open();
  const [connections, names]: string[][] = [[], []];
  stream.on("connection", ({ connection }) => connections?.push(connection));
  stream.on("keytime", () => {
    throw new Error("of the listener");
  });
  stream.on("keytime", ({ name }) => names?.push(name));
  const tasks: (() => void)[] = [];
  const spy = vi.spyOn(globalThis, "queueMicrotask").mockImplementation((task) => void tasks.push(task));
  receive({ op: "events", items: [{ channel: 0, name: "start", phase: 0 }] });
  spy.mockRestore();
  expect([connections, names]).toEqual([[], ["start"]]);
  expect(tasks[0]).toThrow("of the listener");
});

/** A pose message of channel 0 with one joint, f32. */
function poseMessage(sequence: number, rootX: number): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(20 + 52));
  view.setUint8(0, 1);
  view.setUint8(1, 1);
  view.setUint16(2, 1, true);
  view.setUint32(4, sequence, true);
  view.setBigUint64(8, BigInt(1e9 + sequence * 1e7), true);
  view.setFloat32(20 + 20, 1, true);
  view.setFloat32(20 + 24, rootX, true);
  view.setFloat32(20 + 48, 1, true);
  return view.buffer;
}

test("a pose message with numbers that are not finite is counted and otherwise ignored", async () => {
  const figure = await open();
  const first = figure.first();
  const connections: string[] = [];
  stream.on("connection", ({ connection }) => connections.push(connection));
  socket().onmessage?.({ data: poseMessage(1, Number.NaN) } as MessageEvent);
  expect(figure.pose()).toBeNull();
  socket().onmessage?.({ data: poseMessage(2, 0.5) } as MessageEvent);
  expect([...(await first).values]).toEqual([0.5, 0, 0, 0, 0, 0, 1]);
  expect(stream.stats()).toMatchObject({ malformed: 1, reconnects: 0 });
  expect(connections).toEqual([]);
});

/** A verb of two joints, and a figure of it with its first pose. */
async function posed(options: FigureOptions, offset: number[]) {
  const figure = stream.open("reach", options);
  await vi.waitFor(() => expect(ops("open")).toHaveLength(1));
  const skeleton = { names: ["Hips", "Hand"], parents: [-1, 0], offsets: [[0, 0, 0], offset] };
  answer({ skeleton, joints: options.joints ? [...options.joints] : skeleton.names, record_bytes: 68 });
  const content = new DataView(new ArrayBuffer(20 + 68));
  new Uint8Array(content.buffer).set(new Uint8Array(poseMessage(1, 0.5)));
  content.setFloat32(20 + 64, 1, true);
  socket().onmessage?.({ data: content.buffer } as MessageEvent);
  return { figure: await figure, pose: await (await figure).first() };
}

test("positions are those of the figure's frame", async () => {
  const { figure, pose } = await posed({ frame: "unreal" }, [0, 30, 0]);
  expect([...figure.positions(pose)]).toEqual([0.5, 0, 0, 0.5, 30, 0]);
});

test("positions need the order of the skeleton", async () => {
  const { figure, pose } = await posed({ joints: ["Hand", "Hips"] }, [0, 0.3, 0]);
  expect(() => figure.positions(pose)).toThrow(BadRequest);
});

test("after another server's hello all figures are opened again, and the view is sent again", async () => {
  const figure = await open({ adverbs: { x: 0.3 } });
  stream.view([0, 1, 2], 500);
  figure.aim({ x: 0.4 });
  await turn();
  sent.length = 0;
  await reconnected();
  expect(ops("resume")).toMatchObject([{ session: "s1" }]);
  receive({ op: "error", channel: null, code: "unknown_session", detail: "no" });
  await vi.waitFor(() => expect(ops("open")).toHaveLength(1));
  expect(ops("open")[0]).toMatchObject({ adverbs: { x: 0.4, y: 1.5 } });
  expect(ops("view")).toEqual([{ op: "view", x: 0, y: 1, z: 2, budget_kbps: 500 }]);
});

test("a figure that a restarted server refuses is an event, and is not on the stream any more", async () => {
  const figure = await open();
  const first = figure.first();
  const codes: string[] = [];
  stream.on("error", ({ code }) => codes.push(code));
  await reconnected();
  receive({ op: "error", channel: null, code: "unknown_session", detail: "no" });
  await vi.waitFor(() => expect(ops("open")).toHaveLength(2));
  receive({ op: "error", channel: 0, code: "unknown_verb", detail: "unknown verb 'reach'" });
  expect(codes).toEqual(["unknown_verb"]);
  expect(stream.stats().channels).toBe(0);
  await expect(first).rejects.toMatchObject({ code: "unknown_verb" });
});

test("a switch that a restarted server refuses leaves the figure with its verb", async () => {
  const figure = await open();
  const other = figure.switch("arm3");
  await vi.waitFor(() => expect(ops("switch")).toHaveLength(1));
  await reconnected();
  receive({ op: "error", channel: null, code: "unknown_session", detail: "no" });
  await vi.waitFor(() => expect(ops("open")).toHaveLength(2));
  receive({ op: "error", channel: 0, code: "unknown_verb", detail: "unknown verb 'arm3'" });
  await expect(other).rejects.toMatchObject({ code: "unknown_verb" });
  await vi.waitFor(() => expect(ops("open").map(({ verb }) => verb)).toEqual(["reach", "arm3", "reach"]));
});

test("a figure that was closed without a connection is closed on the server after a resume", async () => {
  await open();
  const figure = await open();
  vi.useFakeTimers();
  socket().onclose?.({ code: 1006, reason: "" } as CloseEvent);
  figure.close();
  await vi.advanceTimersByTimeAsync(7000);
  vi.useRealTimers();
  for (const channel of [0, 1]) answer({ channel, resumed: true });
  pong();
  expect(ops("close")).toEqual([{ op: "close", channel: 1 }]);
});

test("a stream has a bounded number of figures, and a closed one has none", async () => {
  for (let k = 0; k < 3; k++) {
    const figure = stream.open("reach");
    await vi.waitFor(() => expect(ops("open")).toHaveLength(k + 1));
    answer();
    await figure;
  }
  await expect(stream.open("reach")).rejects.toMatchObject({ code: "too_many_channels" });
  stream.close();
  expect(stream.connection).toBe("closed");
  await expect(stream.open("reach")).rejects.toBeInstanceOf(StreamClosed);
});
