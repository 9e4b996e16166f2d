import { afterEach, expect, test, vi } from "vitest";
import { responseError } from "../errors.js";
import { eventData, follow } from "./events.js";
import type { Send } from "./request.js";

function streamOf(...parts: string[]): ReadableStream<Uint8Array> {
  const bytes = new TextEncoder();
  return new ReadableStream({
    start(control) {
      for (const part of parts) control.enqueue(bytes.encode(part));
      control.close();
    },
  });
}

afterEach(() => void vi.useRealTimers());

test("events are read across parts; comments and unfinished events are not", async () => {
  const data: string[] = [];
  const parts = [
    "event: progress\nda",
    'ta: {"a": 1}\n',
    "\n: still here\n\ndata: one\ndata: two\r\n\r\n",
    "data: cut",
  ];
  for await (const each of eventData(streamOf(...parts))) data.push(each);
  expect(data).toEqual(['{"a": 1}', "one\ntwo"]);
});

test("a lost connection is opened again until the last event", async () => {
  vi.useFakeTimers();
  const answers = [streamOf("data: 1\n\n"), streamOf("data: 2\n\ndata: end\n\ndata: 3\n\n")];
  const paths: string[] = [];
  const send: Send = async (path) => {
    paths.push(path);
    return new Response(answers.shift() ?? null);
  };
  const data: string[] = [];
  follow(send, "/events", (each) => data.push(each) > 0 && each === "end");
  await vi.advanceTimersByTimeAsync(30_000);
  expect(data).toEqual(["1", "2", "end"]);
  expect(paths).toEqual(["/events", "/events"]);
});

test("a refusal ends it; too many requests delay it", async () => {
  vi.useFakeTimers();
  const problems = [
    responseError(429, "too_many_requests", "", [], 9000),
    responseError(404, "unknown_refinement", ""),
  ];
  let requests = 0;
  const send: Send = async () => {
    requests++;
    throw problems.shift() ?? new Error("one request too many");
  };
  follow(send, "/events", () => false);
  await vi.advanceTimersByTimeAsync(8000);
  expect(requests).toBe(1);
  await vi.advanceTimersByTimeAsync(60_000);
  expect(requests).toBe(2);
});

test("it ends when it is stopped", async () => {
  vi.useFakeTimers();
  let requests = 0;
  const stop = follow(
    async () => {
      requests++;
      return new Response(streamOf());
    },
    "/events",
    () => false,
  );
  await vi.advanceTimersByTimeAsync(100);
  stop();
  await vi.advanceTimersByTimeAsync(60_000);
  expect(requests).toBe(1);
});
