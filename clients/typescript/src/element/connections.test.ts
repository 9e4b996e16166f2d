/** Connections that elements share, with servers that fail. */

import { expect, test, vi } from "vitest";
import type { Stream } from "../stream/stream.js";
import { Connections } from "./connections.js";

const close = vi.fn();
const streamOf = () => Promise.resolve({ close } as unknown as Stream);

test("elements of one server and key share a connection until the last one is removed", async () => {
  close.mockClear();
  const connect = vi.fn(streamOf);
  const connections = new Connections(connect);
  const [first, second] = [connections.acquire("a", ""), connections.acquire("a", "")];
  connections.acquire("a", "key");
  expect(connect.mock.calls).toEqual([
    ["a", ""],
    ["a", "key"],
  ]);
  connections.release(first);
  await first.stream;
  expect(close).not.toHaveBeenCalled();
  connections.release(second);
  await vi.waitFor(() => expect(close).toHaveBeenCalledOnce());
  expect(connections.acquire("a", "")).not.toBe(first);
});

test("the release of a connection that failed does not close a later one", async () => {
  close.mockClear();
  const answers = [() => Promise.reject(new Error("offline")), streamOf];
  const connections = new Connections(() => (answers.shift() ?? streamOf)());
  const failed = connections.acquire("a", "");
  await expect(failed.stream).rejects.toThrow("offline");
  const later = connections.acquire("a", "");
  connections.release(failed);
  await later.stream;
  expect(connections.acquire("a", "")).toBe(later);
  expect(close).not.toHaveBeenCalled();
});
