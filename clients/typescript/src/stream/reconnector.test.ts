import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { Reconnector, type Socket } from "./reconnector.js";

class FakeSocket implements Socket {
  binaryType: BinaryType = "blob";
  onopen: Socket["onopen"] = null;
  onmessage: Socket["onmessage"] = null;
  onclose: Socket["onclose"] = null;
  closed = false;
  readonly sent: unknown[] = [];
  constructor(readonly protocols: string[]) {}
  send(message: unknown): void {
    this.sent.push(message);
  }
  close(): void {
    this.closed = true;
  }
  end(code: number, reason = ""): void {
    this.onclose?.call(this as unknown as WebSocket, { code, reason } as CloseEvent);
  }
}

let sockets: FakeSocket[];
let events: unknown[][];
let reconnector: Reconnector;
const last = () => sockets.at(-1) as FakeSocket;

beforeEach(() => {
  vi.useFakeTimers();
  sockets = [];
  events = [];
  const open = (protocols: string[]) => {
    const socket = new FakeSocket(protocols);
    sockets.push(socket);
    return socket;
  };
  reconnector = new Reconnector(open, {
    opened: () => void events.push(["opened"]),
    received: (data) => void events.push(["received", data]),
    lost: (detail, againInS) => void events.push(["lost", detail, againInS]),
    unauthenticated: (key, detail) => void events.push(["unauthenticated", key, detail]),
  });
});
afterEach(() => void vi.useRealTimers());

test("the key is offered as a subprotocol, and none without a key", () => {
  reconnector.setKey("");
  expect(last().protocols).toEqual(["adverb.v1"]);
  reconnector.setKey("adv_1");
  expect(sockets[0]?.closed).toBe(true);
  expect(last().protocols).toEqual(["adverb.v1", "adverb.bearer.adv_1"]);
  reconnector.setKey("adv_1");
  expect(sockets).toHaveLength(2);
});

test("a lost connection is opened again with the same key after growing pauses", async () => {
  reconnector.setKey("adv_1");
  const pauses: number[] = [];
  for (let k = 0; k < 8; k++) {
    last().end(1006);
    pauses.push(events.at(-1)?.[2] as number);
    await vi.advanceTimersByTimeAsync(8000);
  }
  expect(sockets).toHaveLength(9);
  expect(last().protocols).toContain("adverb.bearer.adv_1");
  expect(pauses[0]).toBeLessThanOrEqual(0.25);
  expect(pauses[7]).toBeGreaterThanOrEqual(4);
  reconnector.succeed();
  last().end(1006);
  expect(events.at(-1)?.[2]).toBeLessThanOrEqual(0.25);
});

test("a key that is not valid any more ends the attempts until there is another", async () => {
  reconnector.setKey("adv_1");
  last().end(4401, "the key was revoked or has expired");
  expect(events).toEqual([
    ["lost", "the key was revoked or has expired", 0],
    ["unauthenticated", "adv_1", "the key was revoked or has expired"],
  ]);
  await vi.advanceTimersByTimeAsync(60_000);
  expect(sockets).toHaveLength(1);
  reconnector.setKey("adv_2");
  expect(last().protocols).toContain("adverb.bearer.adv_2");
});

test("while a key is needed it stays disconnected", async () => {
  reconnector.setKey("");
  last().end(1006);
  reconnector.setKey(null);
  await vi.advanceTimersByTimeAsync(60_000);
  expect(sockets).toHaveLength(1);
  expect(reconnector.connected).toBe(false);
});

test("too many streams: the longest pause", () => {
  reconnector.setKey("");
  last().end(4029, "this key may have 2 streams");
  expect(events.at(-1)?.slice(0, 2)).toEqual(["lost", "this key may have 2 streams"]);
  expect(events.at(-1)?.[2]).toBeGreaterThanOrEqual(4);
});

test("a socket that was given up is not listened to", () => {
  reconnector.setKey("adv_1");
  const first = last();
  reconnector.setKey("adv_2");
  const count = events.length;
  first.end(4401);
  first.onmessage?.call(first as unknown as WebSocket, { data: "late" } as MessageEvent);
  expect(events).toHaveLength(count);
});
