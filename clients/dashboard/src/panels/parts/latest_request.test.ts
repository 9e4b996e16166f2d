import { expect, test, vi } from "vitest";
import { Latest } from "./latest_request";

/** Questions that are answered by hand. */
function desk() {
  const asked: { path: string; signal: AbortSignal; answer: (value: string) => void; refuse: (why: Error) => void }[] =
    [];
  const told: unknown[] = [];
  const latest = new Latest<string>(
    (path, signal) => new Promise((answer, refuse) => asked.push({ path, signal, answer, refuse })),
    (answer) => told.push(answer),
  );
  return { latest, asked, told, paths: () => asked.map(({ path }) => path) };
}

test("while one is asked only the newest wish waits", async () => {
  const { latest, asked, told, paths } = desk();
  for (const path of ["a", "b", "c"]) latest.want(path, false);
  expect(paths()).toEqual(["a"]);
  asked[0]?.answer("A");
  await vi.waitFor(() => expect(told).toEqual([{ value: "A" }]));
  expect(paths()).toEqual(["a", "c"]);
  expect(latest.late).toBe(true);
});

test("what was told is not asked again", async () => {
  const { latest, asked, told, paths } = desk();
  latest.want("a", false);
  asked[0]?.answer("A");
  await vi.waitFor(() => expect(told).toHaveLength(1));
  latest.want("a", false);
  expect(paths()).toEqual(["a"]);
  expect(latest.late).toBe(false);
});

test("a useless question is dropped, and its answer not told", async () => {
  const { latest, asked, told, paths } = desk();
  latest.want("a", false);
  latest.want("b", true);
  expect(asked[0]?.signal.aborted).toBe(true);
  expect(paths()).toEqual(["a", "b"]);
  asked[0]?.answer("A");
  asked[1]?.answer("B");
  await vi.waitFor(() => expect(told).toEqual([{ value: "B" }]));
});

test("a failure is told, and the same may be asked again", async () => {
  const { latest, asked, told, paths } = desk();
  const why = new Error("no");
  latest.want("a", false);
  asked[0]?.refuse(why);
  await vi.waitFor(() => expect(told).toEqual([{ problem: why }]));
  latest.want("a", false);
  expect(paths()).toEqual(["a", "a"]);
});

test("nothing is told after the end", async () => {
  const { latest, asked, told } = desk();
  latest.want("a", false);
  latest.stop();
  asked[0]?.answer("A");
  await new Promise((done) => setTimeout(done));
  expect(told).toEqual([]);
});
