/** Switches of a figure, its end, and its channel after a reconnection. */

import { beforeEach, expect, test, vi } from "vitest";
import { ChannelError, StreamClosed } from "../errors.js";
import { answer, begin, open, ops, pong, receive, reconnected, socket, stream, turn } from "./server.fixture.js";

beforeEach(begin);

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
