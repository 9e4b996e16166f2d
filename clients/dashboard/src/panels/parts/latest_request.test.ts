import { expect, test, vi } from "vitest";
import { LatestRequest } from "./latest_request";

/** Requests resolved by the tests. */
function manualRequests() {
  const requests: {
    path: string;
    signal: AbortSignal;
    resolve: (value: string) => void;
    reject: (error: Error) => void;
  }[] = [];
  const results: unknown[] = [];
  const latest = new LatestRequest<string>(
    (path, signal) => new Promise((resolve, reject) => requests.push({ path, signal, resolve, reject })),
    (resolve) => results.push(resolve),
  );
  return { latest, requests, results, paths: () => requests.map(({ path }) => path) };
}

test("during a request only the newest path waits", async () => {
  const { latest, requests, results, paths } = manualRequests();
  for (const path of ["a", "b", "c"]) latest.request(path, false);
  expect(paths()).toEqual(["a"]);
  requests[0]?.resolve("A");
  await vi.waitFor(() => expect(results).toEqual([{ value: "A" }]));
  expect(paths()).toEqual(["a", "c"]);
  expect(latest.pending).toBe(true);
});

test("an results path is not requested again", async () => {
  const { latest, requests, results, paths } = manualRequests();
  latest.request("a", false);
  requests[0]?.resolve("A");
  await vi.waitFor(() => expect(results).toHaveLength(1));
  latest.request("a", false);
  expect(paths()).toEqual(["a"]);
  expect(latest.pending).toBe(false);
});

test("a useless request is aborted and its result ignored", async () => {
  const { latest, requests, results, paths } = manualRequests();
  latest.request("a", false);
  latest.request("b", true);
  expect(requests[0]?.signal.aborted).toBe(true);
  expect(paths()).toEqual(["a", "b"]);
  requests[0]?.resolve("A");
  requests[1]?.resolve("B");
  await vi.waitFor(() => expect(results).toEqual([{ value: "B" }]));
});

test("a failure is reported, and the path can be requested again", async () => {
  const { latest, requests, results, paths } = manualRequests();
  const error = new Error("no");
  latest.request("a", false);
  requests[0]?.reject(error);
  await vi.waitFor(() => expect(results).toEqual([{ problem: error }]));
  latest.request("a", false);
  expect(paths()).toEqual(["a", "a"]);
});

test("nothing is reported after stop", async () => {
  const { latest, requests, results } = manualRequests();
  latest.request("a", false);
  latest.stop();
  requests[0]?.resolve("A");
  await new Promise((done) => setTimeout(done));
  expect(results).toEqual([]);
});
