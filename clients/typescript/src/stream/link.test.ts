/** A link whose server is silent, or about to stop. */

import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { Link } from "./link.js";
import { Protocol, type ProtocolEvents } from "./protocol.js";
import type { Socket } from "./reconnector.js";

let sockets: WebSocket[];
let link: Link;
let lost: [detail: string, againInS: number][];

const receive = (message: object) => sockets.at(-1)?.onmessage?.({ data: JSON.stringify(message) } as MessageEvent);
const hello = () => receive({ op: "hello", session: `s${sockets.length}`, max_channels: 3 });

beforeEach(() => {
  vi.useFakeTimers();
  [sockets, lost] = [[], []];
  const open = () => {
    const made = { send: () => {}, close: () => {} } as unknown as WebSocket;
    sockets.push(made);
    queueMicrotask(() => made.onopen?.({} as Event));
    return made as Socket;
  };
  const nothing = () => {};
  const events: ProtocolEvents = {
    ...{ openChannels: 1, started: nothing, resumed: nothing, opened: nothing, rejected: nothing, record: nothing },
    ...{ tick: nothing, version: nothing, keytime: nothing, ended: nothing },
  };
  link = new Link(open, new Protocol(events), {
    connection: (connection, detail, againInS) => void (connection !== "open" && lost.push([detail, againInS])),
    unauthenticated: nothing,
  });
  link.setKey("");
});
afterEach(() => {
  link.stop();
  vi.useRealTimers();
});

test("a connection without a session is given up, also after an earlier session", async () => {
  await vi.advanceTimersByTimeAsync(10_000);
  expect(sockets).toHaveLength(2);
  hello();
  sockets.at(-1)?.onclose?.({ code: 1006, reason: "" } as CloseEvent);
  await vi.advanceTimersByTimeAsync(500);
  expect(sockets).toHaveLength(3);
  await vi.advanceTimersByTimeAsync(10_000);
  expect(sockets).toHaveLength(4);
  expect(lost.map(([detail]) => detail)).toEqual(["no session after 8 s", "connection closed (1006)", lost[0]?.[0]]);
});

test.each([
  [20, 20],
  [1000, 60],
])("a server that stops requests a pause of %d s, once, and at most 60 s", async (requestedS, pauseS) => {
  hello();
  receive({ op: "drain", detail: "the server stops", reconnect_after_s: requestedS });
  sockets.at(-1)?.onclose?.({ code: 1012, reason: "" } as CloseEvent);
  expect(lost[0]?.[1]).toBe(pauseS);
  await vi.advanceTimersByTimeAsync(1000 * pauseS);
  expect(sockets).toHaveLength(2);
  sockets.at(-1)?.onclose?.({ code: 1006, reason: "" } as CloseEvent);
  expect(lost[1]?.[1]).toBeLessThan(1);
});
