import { type Motion, type Opened, writeAdverbs, writeBulkAdverbs } from "adverb-client";
import { beforeEach, describe, expect, test } from "vitest";
import { Session } from "./session";
import type { FromWorker, StreamTarget } from "./worker_messages";

const MOTION: Motion = {
  ...{ verb: "reach", method: "", names: ["x", "y"], fps: 60, encoding: "f32" },
  ...{ playing: true, speed: 1, loop: true, seek: { serial: 0, phase: 0.25 } },
};

/** Server with the protocol of docs/wire.md and zero latency. */
class Server {
  readonly received: Record<string, unknown>[] = [];
  readonly adverbMessages: ArrayBuffer[] = [];
  readonly open = new Map<number, Opened>();
  joints = ["Hips", "Spine"];
  silent = false;
  /** Phase lead of the comparison. */
  drift = 0;
  now = 1000;
  private sequence = 0;

  constructor(private readonly session: Session) {}

  connect(name: string): void {
    this.session.protocol.attach((message) => this.take(message));
    this.send({ op: "hello", session: name, max_channels: 1024, grace_s: 10, server_time_ns: 1e15 });
  }

  send(message: object): void {
    this.session.protocol.receive(JSON.stringify(message), this.now);
  }

  /** Send one tick with all channels at a phase. */
  tick(phase: number, step = 1): void {
    this.now += 1000 / 60;
    this.sequence += step;
    this.session.protocol.receive(this.message(phase), this.now);
  }

  /** Step until no more messages are sent. */
  settle(): void {
    for (let before = -1; before !== this.received.length + this.adverbMessages.length; ) {
      before = this.received.length + this.adverbMessages.length;
      this.session.step(this.now);
    }
  }

  ops(op: string): Record<string, unknown>[] {
    return this.received.filter((message) => message.op === op);
  }

  take(message: string | ArrayBuffer): void {
    if (typeof message !== "string") return void this.adverbMessages.push(message);
    const request = JSON.parse(message) as Record<string, never> & { op: string; channel: number; t: number };
    this.received.push(request);
    if (this.silent) return;
    if (request.op === "open") this.opened(request);
    if (request.op === "close") this.open.delete(request.channel);
    if (request.op === "ping") this.send({ op: "pong", t: request.t, server_time_ns: (this.now + 5000) * 1e6 });
  }

  opened(request: { channel: number } & Record<string, never>): void {
    const opened = {
      ...{
        op: "opened",
        channel: request.channel,
        verb: request.verb,
        version: 3,
        method: request.method ?? "corrected",
      },
      skeleton: { names: this.joints, parents: this.joints.map((_, k) => k - 1), offsets: [] },
      ...{ adverbs: [], joints: this.joints, encoding: request.encoding, space: "local", frame: "gltf" },
      ...{ fps: request.fps, looping: false, keytimes: [], follow: [0.4, 0.6], resumed: false },
      record_bytes: 36 + 16 * this.joints.length,
    } as unknown as Opened;
    this.open.set(request.channel, opened);
    this.send(opened);
  }

  private message(phase: number): ArrayBuffer {
    const bytes = 36 + 16 * this.joints.length;
    const view = new DataView(new ArrayBuffer(20 + bytes * this.open.size));
    view.setUint16(0, 0x0101, true);
    view.setUint16(2, this.open.size, true);
    view.setUint32(4, this.sequence, true);
    view.setBigUint64(8, BigInt(Math.round((this.now + 5000) * 1e6)), true);
    [...this.open.keys()].forEach((channel, k) => {
      const at = 20 + k * bytes;
      view.setUint16(at, channel, true);
      view.setUint32(at + 4, 3, true);
      const own = phase + (channel >= 60_000 ? this.drift : 0);
      [own, own, 0.001, 1, channel, 0, 0].forEach((value, i) => {
        view.setFloat32(at + 8 + 4 * i, value, true);
      });
      for (let j = 0; j < this.joints.length; j++) view.setFloat32(at + 48 + 16 * j, 1, true);
    });
    return view.buffer;
  }
}

let events: FromWorker[];
let session: Session;
let server: Server;

beforeEach(() => {
  events = [];
  session = new Session((message) => void events.push(message));
  server = new Server(session);
});

function setTarget(part: Partial<Motion> = {}, crowd = 1, comparison: Partial<Motion> | null = null): void {
  const main = { ...MOTION, ...part };
  const adverbs = Array.from({ length: crowd }, (_, k) => [0.1 + k, 0.2]);
  const target: StreamTarget = { main, adverbs, comparison: comparison && { ...main, ...comparison } };
  session.setTarget(target);
}

test("the target is opened with one message and displayed", () => {
  setTarget();
  server.connect("a");
  server.settle();
  expect(server.ops("open")).toEqual([
    {
      ...{ op: "open", channel: 0, verb: "reach", adverbs: { x: 0.1, y: 0.2 }, fps: 60, encoding: "f32" },
      ...{ phase: 0.25, speed: 1, play: true, loop: true, events: true },
    },
  ]);
  expect(session.protocol.connection).toBe("open");
  expect(session.draw(server.now, []).main).toBeNull();
  for (let k = 0; k < 10; k++) server.tick(0.3 + 0.01 * k);
  const drawn = session.draw(server.now, []).main;
  expect(drawn?.shown).toMatchObject({ verb: "reach", version: 3, method: "corrected", count: 1 });
  expect(drawn?.shown.error).toBeCloseTo(0.001, 6);
  expect(drawn?.poses).toHaveLength(11);
});

test("only changes are sent, adverbs as binary", () => {
  setTarget();
  server.connect("a");
  server.settle();
  server.received.length = 0;
  session.setTarget({ main: MOTION, adverbs: [[0.5, 0.2]], comparison: null });
  server.settle();
  expect(server.adverbMessages).toEqual([writeAdverbs(0, [0.5, 0.2])]);
  expect(server.received).toEqual([]);
  session.setTarget({ main: { ...MOTION, speed: 2, playing: false }, adverbs: [[0.5, 0.2]], comparison: null });
  server.settle();
  expect(server.received).toEqual([{ op: "set", channel: 0, speed: 2, play: false }]);
  session.setTarget({ main: { ...MOTION, seek: { serial: 1, phase: 0.7 } }, adverbs: [[0.5, 0.2]], comparison: null });
  server.settle();
  expect(server.received.at(-1)).toEqual({ op: "set", channel: 0, speed: 1, play: true, phase: 0.7 });
});

test("one message steers a crowd, whose keytimes are not requested", () => {
  setTarget({}, 300);
  server.connect("a");
  server.settle();
  expect(server.ops("open").map((open) => open.events)).toEqual([true, ...Array<boolean>(299).fill(false)]);
  const adverbs = Array.from({ length: 300 }, (_, k) => [0.5 + 0.001 * k, 0.2]);
  session.setTarget({ main: MOTION, adverbs, comparison: null });
  session.step(server.now);
  const [message, ...others] = server.adverbMessages;
  expect(others).toEqual([]);
  const goals = adverbs.map((row, channel) => ({ channel, adverbs: row }));
  expect(message?.byteLength).toBe(4 + 12 * 300);
  const [ordered] = writeBulkAdverbs(goals);
  const rows = (content: ArrayBuffer | undefined) =>
    Array.from({ length: 300 }, (_, k) =>
      new Uint8Array(content as ArrayBuffer).slice(4 + 12 * k, 16 + 12 * k).join(),
    ).sort();
  expect(rows(message)).toEqual(rows(ordered));
  server.settle();
  expect(server.adverbMessages).toHaveLength(1);
});

test("keytimes of the steered character are reported, in order", () => {
  setTarget({}, 2);
  server.connect("a");
  server.settle();
  const items = [
    { channel: 1, name: "apex", phase: 0.5 },
    { channel: 0, name: "apex", phase: 0.5 },
    { channel: 0, name: "end", phase: 1 },
  ];
  server.send({ op: "events", items });
  expect(events.filter(({ kind }) => kind === "event")).toEqual([
    { kind: "event", name: "apex", phase: 0.5 },
    { kind: "event", name: "end", phase: 1 },
  ]);
});

test("a crowd opens and closes in bounded bursts", () => {
  setTarget({}, 1000);
  server.silent = true;
  server.connect("a");
  for (let k = 0; k < 50; k++) session.step(server.now);
  const request = server.ops("open").length;
  expect(request).toBeLessThanOrEqual(48);
  server.silent = false;
  for (const open of server.ops("open")) server.opened(open as never);
  server.settle();
  expect(server.open.size).toBe(1000);
  server.tick(0.5);
  expect(session.draw(server.now + 50, []).main?.shown.count).toBe(1000);
  setTarget({}, 3);
  session.step(server.now);
  expect(server.ops("close").length).toBeLessThanOrEqual(192);
  server.settle();
  expect([...server.open.keys()]).toEqual([0, 1, 2]);
  for (let k = 0; k < 10; k++) server.tick(0.5);
  const drawn = session.draw(server.now, []).main;
  expect([drawn?.shown.count, drawn?.poses[0], drawn?.poses[11]]).toEqual([3, 0, 1]);
});

test("records of the previous skeleton are read until the new channel is open", () => {
  setTarget();
  server.connect("a");
  server.settle();
  for (let k = 0; k < 5; k++) server.tick(0.5);
  server.silent = true;
  setTarget({ verb: "arm3" });
  server.settle();
  expect(server.received.slice(-2).map(({ op }) => op)).toEqual(["close", "open"]);
  server.tick(0.6);
  expect(session.draw(server.now, []).main?.shown.verb).toBe("reach");
  server.joints = ["Base", "Upper", "Lower"];
  server.opened(server.ops("open").at(-1) as never);
  server.tick(0.1);
  const drawn = session.draw(server.now, []).main;
  expect([drawn?.shown.verb, drawn?.poses.length]).toEqual(["arm3", 15]);
});

test("a resumed session resends settings of confirmed channels and opens the others", () => {
  setTarget({}, 2);
  server.connect("a");
  server.settle();
  for (let k = 0; k < 3; k++) server.tick(0.5);
  session.protocol.lost();
  expect(session.protocol.connection).toBe("lost");
  setTarget({ speed: 2 }, 2);
  server.silent = true;
  server.received.length = 0;
  server.connect("b");
  expect(server.received.map(({ op }) => op)).toEqual(["resume", "ping"]);
  expect(server.received[0]).toMatchObject({ session: "a", last_seq: 3 });
  server.send({ ...(server.open.get(0) as Opened), resumed: true });
  expect(session.protocol.connection).toBe("lost");
  server.silent = false;
  server.send({ op: "pong", t: server.ops("ping")[0]?.t, server_time_ns: 1e15 });
  server.settle();
  expect(session.protocol.connection).toBe("open");
  expect(server.ops("set")[0]).toMatchObject({ channel: 0, speed: 2, play: true, loop: true, fps: 60 });
  expect(server.ops("open").map(({ channel }) => channel)).toEqual([1]);
  expect(session.stats(server.now).reconnects).toBe(1);
});

test("an unknown session reopens all channels at their phase", () => {
  setTarget();
  server.connect("a");
  server.settle();
  for (let k = 0; k < 3; k++) server.tick(0.625);
  session.protocol.lost();
  server.silent = true;
  server.received.length = 0;
  server.connect("b");
  server.silent = false;
  server.send({ op: "error", channel: null, code: "unknown_session", detail: "no such session" });
  server.settle();
  expect(server.ops("open")).toMatchObject([{ channel: 0, phase: 0.625 }]);
  expect(events.filter(({ kind }) => kind === "refused")).toEqual([]);
});

test("a refusal is reported once; only a loading server is retried", () => {
  setTarget({ method: "magic" });
  server.silent = true;
  server.connect("a");
  const refuse = (code: string) => server.send({ op: "error", channel: 0, code, detail: `no: ${code}` });
  refuse("unknown_method");
  server.settle();
  expect(events.filter(({ kind }) => kind === "refused")).toHaveLength(1);
  expect(server.ops("open")).toHaveLength(1);
  setTarget({ method: "rbf" });
  session.step(server.now);
  expect(server.ops("open")).toHaveLength(2);
  refuse("not_ready");
  server.settle();
  expect(server.ops("open")).toHaveLength(2);
  server.now += 1100;
  server.settle();
  expect(server.ops("open")).toHaveLength(3);
});

describe("a motion that switches", () => {
  const walk = { verb: "walk", switches: true, halfLife: 0.2 };
  const jump = { ...walk, verb: "jump", loop: false };

  beforeEach(() => {
    setTarget(walk);
    server.connect("a");
    server.settle();
    for (let k = 0; k < 5; k++) server.tick(0.5);
    server.silent = true;
    server.received.length = 0;
  });

  const answer = () => server.opened({ channel: 0, fps: 60, encoding: "f32", ...server.ops("switch").at(-1) } as never);

  test("changes its verb without reopening, and without a cross-fade of its frames", () => {
    setTarget(jump);
    server.settle();
    expect(server.received).toEqual([{ op: "switch", channel: 0, verb: "jump", adverbs: { x: 0.1, y: 0.2 } }]);
    answer();
    expect(session.draw(server.now + 20, []).main?.shown.verb).toBe("walk");
    server.silent = false;
    server.settle();
    expect(server.received.slice(1)).toEqual([{ op: "set", channel: 0, loop: false }]);
    server.tick(0.51);
    const drawn = session.draw(server.now + 100, []).main;
    expect(drawn?.shown).toMatchObject({ verb: "jump", inTransition: false });
  });

  test("keeps its verb after a refusal until the target changes", () => {
    setTarget(jump);
    server.settle();
    server.send({ op: "error", channel: 0, code: "skeleton_mismatch", detail: "no" });
    server.settle();
    expect(server.ops("switch")).toHaveLength(1);
    expect(session.openChannels).toBe(1);
    setTarget({ ...walk, speed: 2 });
    server.settle();
    expect(server.received.slice(1)).toEqual([{ op: "set", channel: 0, speed: 2 }]);
  });

  test("is switched again if a disconnect lost the message", () => {
    setTarget(jump);
    server.settle();
    session.protocol.lost();
    server.connect("b");
    server.send({ ...(server.open.get(0) as Opened), resumed: true });
    server.send({ op: "pong", t: server.ops("ping").at(-1)?.t, server_time_ns: 1e15 });
    server.settle();
    expect(server.ops("switch")).toHaveLength(2);
  });
});

test("distant characters are streamed at half the rate, and phases of a crowd differ", () => {
  session.setTarget({
    main: MOTION,
    adverbs: [
      [0, 0],
      [0, 0],
      [0, 0],
    ],
    comparison: null,
    distant: [false, false, true],
  });
  server.connect("a");
  server.settle();
  const opens = server.ops("open").sort((a, b) => Number(a.channel) - Number(b.channel));
  expect(opens.map(({ fps }) => fps)).toEqual([60, 60, 30]);
  expect(new Set(opens.map(({ phase }) => phase)).size).toBe(3);
});

test("the comparison is opened and realigned when its phase drifts", () => {
  setTarget({}, 1, { method: "rbf" });
  server.connect("a");
  server.settle();
  server.tick(0.5);
  expect(session.draw(server.now, []).comparison?.shown.method).toBe("rbf");
  server.settle();
  expect(server.ops("set")).toEqual([]);
  server.drift = 0.05;
  for (let k = 0; k < 5; k++) server.tick(0.75);
  server.settle();
  expect(server.ops("set")).toEqual([{ op: "set", channel: 60_000, phase: 0.75 }]);
  setTarget();
  server.settle();
  expect([...server.open.keys()]).toEqual([0]);
  expect(session.draw(server.now, []).comparison).toBeNull();
});

test("gaps and dropped frames are counted, repeated messages are ignored", () => {
  setTarget();
  server.connect("a");
  server.settle();
  server.tick(0.1);
  server.tick(0.2, 4);
  server.tick(0.3, 0);
  expect(session.stats(server.now)).toMatchObject({ gaps: 1, channels: 1 });
  expect(session.stats(server.now).latenessP50Ms).toBeCloseTo(0, 1);
});

test("records of unknown channels and invalid text messages are errors", () => {
  setTarget();
  server.connect("a");
  server.settle();
  server.open.set(7, server.open.get(0) as Opened);
  expect(() => server.tick(0.1)).toThrow(/channel 7, which was not opened/);
  expect(() => session.protocol.receive("{", 0)).toThrow(/not JSON/);
  expect(() => session.protocol.receive('{"op":"opened","channel":"0"}', 0)).toThrow(/'channel' is not a number/);
});
