import { beforeEach, expect, test } from "vitest";
import type { Opened } from "../types";
import { writeAdverbs } from "./decode";
import { Session } from "./session";
import type { FromWorker, Motion, Wish } from "./worker_messages";

const MOTION: Motion = {
  ...{ verb: "reach", method: "", names: ["x", "y"], fps: 60, encoding: "f32" },
  ...{ playing: true, speed: 1, loop: true, seek: { serial: 0, phase: 0.25 } },
};

/** The far end, as docs/wire.md describes it, with one clock: each message takes no time. */
class Server {
  readonly heard: Record<string, unknown>[] = [];
  readonly aims: ArrayBuffer[] = [];
  readonly open = new Map<number, Opened>();
  joints = ["Hips", "Spine"];
  silent = false;
  /** How far the other side is ahead. */
  drift = 0;
  now = 1000;
  private sequence = 0;

  constructor(private readonly session: Session) {}

  connect(name: string): void {
    this.session.attach((message) => this.take(message));
    this.say({ op: "hello", session: name, max_channels: 1024, grace_s: 10, server_time_ns: 1e15 });
  }

  say(message: object): void {
    this.session.receive(JSON.stringify(message), this.now);
  }

  /** Let a tick pass: a message with all channels, at a phase. */
  tick(phase: number, step = 1): void {
    this.now += 1000 / 60;
    this.sequence += step;
    this.session.receive(this.message(phase), this.now);
  }

  /** Turns until nothing more is said. */
  settle(): void {
    for (let before = -1; before !== this.heard.length + this.aims.length; ) {
      before = this.heard.length + this.aims.length;
      this.session.turn(this.now);
    }
  }

  ops(op: string): Record<string, unknown>[] {
    return this.heard.filter((message) => message.op === op);
  }

  take(message: string | ArrayBuffer): void {
    if (typeof message !== "string") return void this.aims.push(message);
    const asked = JSON.parse(message) as Record<string, never> & { op: string; channel: number; t: number };
    this.heard.push(asked);
    if (this.silent) return;
    if (asked.op === "open") this.opened(asked);
    if (asked.op === "close") this.open.delete(asked.channel);
    if (asked.op === "ping") this.say({ op: "pong", t: asked.t, server_time_ns: (this.now + 5000) * 1e6 });
  }

  opened(asked: { channel: number } & Record<string, never>): void {
    const opened = {
      ...{ op: "opened", channel: asked.channel, verb: asked.verb, version: 3, method: asked.method ?? "corrected" },
      skeleton: { names: this.joints, parents: this.joints.map((_, k) => k - 1), offsets: [] },
      ...{ adverbs: [], joints: this.joints, encoding: asked.encoding, space: "local", frame: "gltf" },
      ...{ fps: asked.fps, looping: false, keytimes: [], follow: [0.4, 0.6], resumed: false },
      record_bytes: 36 + 16 * this.joints.length,
    } as unknown as Opened;
    this.open.set(asked.channel, opened);
    this.say(opened);
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

let told: FromWorker[];
let session: Session;
let server: Server;

beforeEach(() => {
  told = [];
  session = new Session((message) => void told.push(message));
  server = new Server(session);
});

function want(part: Partial<Motion> = {}, crowd = 1, other: Partial<Motion> | null = null): void {
  const main = { ...MOTION, ...part };
  const adverbs = Array.from({ length: crowd }, (_, k) => [0.1 + k, 0.2]);
  const wish: Wish = { main, adverbs, other: other && { ...main, ...other } };
  session.want(wish);
}

test("what is wished is opened, in one message, and shown", () => {
  want();
  server.connect("a");
  server.settle();
  expect(server.ops("open")).toEqual([
    {
      ...{ op: "open", channel: 0, verb: "reach", adverbs: { x: 0.1, y: 0.2 }, fps: 60, encoding: "f32" },
      ...{ phase: 0.25, speed: 1, play: true, loop: true },
    },
  ]);
  expect(session.connection).toBe("open");
  expect(session.draw(server.now, []).main).toBeNull();
  for (let k = 0; k < 10; k++) server.tick(0.3 + 0.01 * k);
  const drawn = session.draw(server.now, []).main;
  expect(drawn?.shown).toMatchObject({ verb: "reach", version: 3, method: "corrected", count: 1 });
  expect(drawn?.shown.error).toBeCloseTo(0.001, 6);
  expect(drawn?.poses).toHaveLength(11);
});

test("only what changed is said, adverbs as bytes, and nothing twice", () => {
  want();
  server.connect("a");
  server.settle();
  server.heard.length = 0;
  session.want({ main: MOTION, adverbs: [[0.5, 0.2]], other: null });
  server.settle();
  expect(server.aims).toEqual([writeAdverbs(0, [0.5, 0.2])]);
  expect(server.heard).toEqual([]);
  session.want({ main: { ...MOTION, speed: 2, playing: false }, adverbs: [[0.5, 0.2]], other: null });
  server.settle();
  expect(server.heard).toEqual([{ op: "set", channel: 0, speed: 2, play: false }]);
  session.want({ main: { ...MOTION, seek: { serial: 1, phase: 0.7 } }, adverbs: [[0.5, 0.2]], other: null });
  server.settle();
  expect(server.heard.at(-1)).toEqual({ op: "set", channel: 0, speed: 1, play: true, phase: 0.7 });
});

test("a crowd comes and goes in bursts that wait for their answers", () => {
  want({}, 1000);
  server.silent = true;
  server.connect("a");
  for (let k = 0; k < 50; k++) session.turn(server.now);
  const asked = server.ops("open").length;
  expect(asked).toBeLessThanOrEqual(48);
  server.silent = false;
  for (const open of server.ops("open")) server.opened(open as never);
  server.settle();
  expect(server.open.size).toBe(1000);
  server.tick(0.5);
  expect(session.draw(server.now + 50, []).main?.shown.count).toBe(1000);
  want({}, 3);
  session.turn(server.now);
  expect(server.ops("close").length).toBeLessThanOrEqual(192);
  server.settle();
  expect([...server.open.keys()]).toEqual([0, 1, 2]);
  for (let k = 0; k < 10; k++) server.tick(0.5);
  const drawn = session.draw(server.now, []).main;
  expect([drawn?.shown.count, drawn?.poses[0], drawn?.poses[11]]).toEqual([3, 0, 1]);
});

test("another skeleton takes the place of the old one, whose last records are still read", () => {
  want();
  server.connect("a");
  server.settle();
  for (let k = 0; k < 5; k++) server.tick(0.5);
  server.silent = true;
  want({ verb: "arm3" });
  server.settle();
  expect(server.heard.slice(-2).map(({ op }) => op)).toEqual(["close", "open"]);
  server.tick(0.6);
  expect(session.draw(server.now, []).main?.shown.verb).toBe("reach");
  server.joints = ["Base", "Upper", "Lower"];
  server.opened(server.ops("open").at(-1) as never);
  server.tick(0.1);
  const drawn = session.draw(server.now, []).main;
  expect([drawn?.shown.verb, drawn?.poses.length]).toEqual(["arm3", 15]);
});

test("a lost connection is taken up again: what was confirmed is told anew, what was not is opened", () => {
  want({}, 2);
  server.connect("a");
  server.settle();
  for (let k = 0; k < 3; k++) server.tick(0.5);
  session.lost();
  expect(session.connection).toBe("lost");
  want({ speed: 2 }, 2);
  server.silent = true;
  server.heard.length = 0;
  server.connect("b");
  expect(server.heard.map(({ op }) => op)).toEqual(["resume", "ping"]);
  expect(server.heard[0]).toMatchObject({ session: "a", last_seq: 3 });
  server.say({ ...(server.open.get(0) as Opened), resumed: true });
  expect(session.connection).toBe("lost");
  server.silent = false;
  server.say({ op: "pong", t: server.ops("ping")[0]?.t, server_time_ns: 1e15 });
  server.settle();
  expect(session.connection).toBe("open");
  expect(server.ops("set")[0]).toMatchObject({ channel: 0, speed: 2, play: true, loop: true, fps: 60 });
  expect(server.ops("open").map(({ channel }) => channel)).toEqual([1]);
  expect(session.stats(server.now).reconnects).toBe(1);
});

test("where the server does not know the session, everything is opened anew at the phase where it was", () => {
  want();
  server.connect("a");
  server.settle();
  for (let k = 0; k < 3; k++) server.tick(0.625);
  session.lost();
  server.silent = true;
  server.heard.length = 0;
  server.connect("b");
  server.silent = false;
  server.say({ op: "error", channel: null, code: "unknown_session", detail: "no such session" });
  server.settle();
  expect(server.ops("open")).toMatchObject([{ channel: 0, phase: 0.625 }]);
  expect(told.filter(({ kind }) => kind === "refused")).toEqual([]);
});

test("a refusal is told once and asked again only for something else; a server that loads is asked again", () => {
  want({ method: "magic" });
  server.silent = true;
  server.connect("a");
  const refuse = (code: string) => server.say({ op: "error", channel: 0, code, detail: `no: ${code}` });
  refuse("unknown_method");
  server.settle();
  expect(told.filter(({ kind }) => kind === "refused")).toHaveLength(1);
  expect(server.ops("open")).toHaveLength(1);
  want({ method: "rbf" });
  session.turn(server.now);
  expect(server.ops("open")).toHaveLength(2);
  refuse("not_ready");
  server.settle();
  expect(server.ops("open")).toHaveLength(2);
  server.now += 1100;
  server.settle();
  expect(server.ops("open")).toHaveLength(3);
});

test("the other side is opened beside the first, and put back to its phase when it has drifted", () => {
  want({}, 1, { method: "rbf" });
  server.connect("a");
  server.settle();
  server.tick(0.5);
  expect(session.draw(server.now, []).other?.shown.method).toBe("rbf");
  server.settle();
  expect(server.ops("set")).toEqual([]);
  server.drift = 0.05;
  for (let k = 0; k < 5; k++) server.tick(0.75);
  server.settle();
  expect(server.ops("set")).toEqual([{ op: "set", channel: 60_000, phase: 0.75 }]);
  want();
  server.settle();
  expect([...server.open.keys()]).toEqual([0]);
  expect(session.draw(server.now, []).other).toBeNull();
});

test("gaps and what the server dropped are counted, messages that come again are not shown", () => {
  want();
  server.connect("a");
  server.settle();
  server.tick(0.1);
  server.tick(0.2, 4);
  server.tick(0.3, 0);
  expect(session.stats(server.now)).toMatchObject({ gaps: 1, channels: 1 });
  expect(session.stats(server.now).lateness_p50_ms).toBeCloseTo(0, 1);
});

test("a record that nobody opened, and text that is no message, are errors", () => {
  want();
  server.connect("a");
  server.settle();
  server.open.set(7, server.open.get(0) as Opened);
  expect(() => server.tick(0.1)).toThrow(/channel 7, which was not opened/);
  expect(() => session.receive("{", 0)).toThrow(/not JSON/);
  expect(() => session.receive('{"op":"opened","channel":"0"}', 0)).toThrow(/'channel' is no number/);
});
