/** Messages of a stream. */

import { beforeEach, expect, test, vi } from "vitest";
import { BadRequest, NoAccess, StreamClosed, TimedOut } from "../errors.js";
import { writeAdverbs, writeBulkAdverbs } from "../wire/decode.js";
import type { FigureOptions } from "./figure.js";
import {
  answer,
  begin,
  binary,
  describe,
  open,
  opened,
  ops,
  receive,
  reconnected,
  requests,
  sent,
  socket,
  stream,
  turn,
} from "./server.fixture.js";
import { connect } from "./stream.js";

beforeEach(begin);

test("a figure is opened with all adverbs: those that are not given are in the middle of the domain", async () => {
  await open({ adverbs: { x: 0.3 }, plant: false, method: "rbf" });
  expect(ops("open")).toMatchObject([
    { channel: 0, verb: "reach", adverbs: { x: 0.3, y: 1.5 }, fps: 60, plant: false, method: "rbf", phase: 0 },
  ]);
  expect(ops("open")[0]).not.toHaveProperty("loop");
});

test("a server that starts late is connected to", async () => {
  let attempts = 0;
  const late = () => {
    if (++attempts > 1) return opened();
    const broken = { close: () => {} } as unknown as WebSocket;
    queueMicrotask(() => broken.onclose?.({ code: 1006, reason: "" } as CloseEvent));
    return broken;
  };
  const other = await connect("http://server", { socket: late, fetch: describe });
  expect([attempts, other.connection]).toEqual([2, "open"]);
  other.close();
});

test("a server that is down is an error when the time is over, a key without access at once", async () => {
  const refused = () => {
    const made = { close: () => {} } as unknown as WebSocket;
    queueMicrotask(() => made.onclose?.({ code: 1006, reason: "" } as CloseEvent));
    return made;
  };
  const offline = async () => Promise.reject(new TypeError("fetch failed"));
  const down = connect("http://server", { socket: refused, fetch: offline, timeoutMs: 50 });
  await expect(down).rejects.toMatchObject({ name: "TransportError", detail: "connection closed (1006)" });
  const denied = async () => new Response('{"code": "unauthenticated", "detail": "unknown key"}', { status: 401 });
  await expect(connect("http://server", { socket: refused, fetch: denied })).rejects.toBeInstanceOf(NoAccess);
});

test("a description is requested again after a new version and in a new session", async () => {
  await open();
  expect(requests).toBe(1);
  await open();
  expect(requests).toBe(1);
  receive({ op: "version", channel: 0, version: 2, record_bytes: 52 });
  await open();
  expect(requests).toBe(2);
  await reconnected();
  receive({ op: "error", channel: null, code: "unknown_session", detail: "no" });
  await expect(stream.open("reach")).rejects.toMatchObject({ code: "too_many_channels" });
  expect(requests).toBe(3);
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
function poseMessage(sequence: number, rootX: number, flags = 0): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(20 + 52));
  view.setUint8(0, 1);
  view.setUint8(1, 1);
  view.setUint16(2, 1, true);
  view.setUint32(4, sequence, true);
  view.setUint8(20 + 3, flags);
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

test("a pose has its support where that is requested", async () => {
  const figure = await open({ support: true });
  expect(ops("open")[0]).toMatchObject({ support: true });
  const rows = [
    [0, null],
    [1, 0],
    [8, 0.5],
    [15, 1],
  ] as const;
  for (const [k, [stored, support]] of rows.entries()) {
    socket().onmessage?.({ data: poseMessage(k + 1, 0, stored << 4) } as MessageEvent);
    await vi.waitFor(() => expect(figure.pose(performance.now() + 1000)?.support).toBe(support));
  }
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
