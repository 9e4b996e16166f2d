import { AdverbError, ResponseError } from "adverb-client";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { DraftSession } from "./draft_session";
import { applied, joined } from "./edits";
import type { Draft, DraftEdit, DraftRest } from "./types";

const CLIP = {
  ...{ name: "a", keytimes: [0, 1, 2], confidence: [1, 0.4, 1], set: false, excluded: false, adverbs: { x: 1 } },
  mends: [
    { index: 0, kind: "spin", text: "", apply: true },
    { index: 1, kind: "spike", text: "", apply: false },
  ],
};
const DRAFT = {
  id: "d",
  revision: 1,
  name: "wave",
  clips: [CLIP, { ...CLIP, name: "b" }],
  adverbs: [],
} as unknown as Draft;

/** A server whose answers are released one by one. */
class Server {
  readonly calls: { edit: DraftEdit; revision: number; answer: (result: Draft | AdverbError) => void }[] = [];
  draft = DRAFT;
  readonly rest = {
    get: async () => this.draft,
    change: (_: string, edit: DraftEdit, revision: number) =>
      new Promise<Draft>((done, failed) => {
        const answer = (result: Draft | AdverbError) => (result instanceof AdverbError ? failed(result) : done(result));
        this.calls.push({ edit, revision, answer });
      }),
  } as unknown as DraftRest;

  /** Accept a call: the draft with its edit in the next revision. */
  async accept(k: number): Promise<void> {
    const { edit } = this.calls[k] as (typeof this.calls)[0];
    this.draft = { ...applied(this.draft, edit), revision: this.draft.revision + 1 };
    this.calls[k]?.answer(this.draft);
    await vi.advanceTimersByTimeAsync(0);
  }
}

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

const keytimes = (...values: number[]): DraftEdit => ({ clips: { a: { keytimes: values } } });

test("edits are shown at once, and one request has the latest of them", async () => {
  const server = new Server();
  const session = new DraftSession(server.rest, DRAFT);
  session.edit(keytimes(0, 1.1, 2));
  session.edit(keytimes(0, 1.2, 2));
  session.edit({ clips: { b: { excluded: true } } });
  expect(session.draft.clips[0]?.keytimes).toEqual([0, 1.2, 2]);
  expect(server.calls).toHaveLength(0);
  await vi.advanceTimersByTimeAsync(500);
  const edit = { clips: { a: { keytimes: [0, 1.2, 2] }, b: { excluded: true } } };
  expect(server.calls.map(({ edit, revision }) => [edit, revision])).toEqual([[edit, 1]]);
});

test("edits during a request follow it with the new revision, and stay visible", async () => {
  const server = new Server();
  const session = new DraftSession(server.rest, DRAFT);
  const saved: number[] = [];
  session.on("saved", ({ revision }) => saved.push(revision));
  session.edit(keytimes(0, 1.1, 2));
  await vi.advanceTimersByTimeAsync(500);
  session.edit(keytimes(0, 1.3, 2));
  await vi.advanceTimersByTimeAsync(500);
  expect(server.calls).toHaveLength(1);
  await server.accept(0);
  expect(session.draft.clips[0]?.keytimes).toEqual([0, 1.3, 2]);
  expect(server.calls[1]?.revision).toBe(2);
  const settled = session.settled();
  await server.accept(1);
  await settled;
  expect(saved).toEqual([2, 3]);
  expect(session.saving).toBe(false);
});

test("another client's change loads the draft again and drops the edit with a message", async () => {
  const server = new Server();
  const session = new DraftSession(server.rest, DRAFT);
  const problems: string[] = [];
  session.on("problem", (text) => problems.push(text));
  session.edit({ name: "mine" });
  await vi.advanceTimersByTimeAsync(500);
  server.draft = { ...DRAFT, revision: 7, name: "theirs" };
  server.calls[0]?.answer(new ResponseError(412, "revision_changed", "changed"));
  await vi.advanceTimersByTimeAsync(0);
  expect(session.draft.name).toBe("theirs");
  expect(problems.at(-1)).toContain("Another client changed this draft");
  session.edit({ name: "again" });
  await vi.advanceTimersByTimeAsync(500);
  expect(server.calls[1]?.revision).toBe(7);
});

test("a refused edit is taken back with the server's reason", async () => {
  const server = new Server();
  const session = new DraftSession(server.rest, DRAFT);
  const problems: string[] = [];
  session.on("problem", (text) => problems.push(text));
  session.edit(keytimes(2, 1, 0));
  await vi.advanceTimersByTimeAsync(500);
  server.calls[0]?.answer(new ResponseError(422, "invalid_draft", "must rise"));
  await vi.advanceTimersByTimeAsync(0);
  expect(session.draft.clips[0]?.keytimes).toEqual([0, 1, 2]);
  expect(problems).toEqual(["must rise"]);
});

test("joined edits have the effect of both, mends by index", () => {
  const first: DraftEdit = { name: "one", clips: { a: { excluded: true, mends: [{ index: 0, apply: false }] } } };
  const second: DraftEdit = {
    clips: {
      a: {
        mends: [
          { index: 1, apply: true },
          { index: 0, apply: true },
        ],
      },
      b: { adverbs: { x: 2 } },
    },
  };
  const both = joined(first, second);
  expect(applied(DRAFT, both)).toEqual(applied(applied(DRAFT, first), second));
  expect(applied(DRAFT, both).clips[0]?.mends.map(({ apply }) => apply)).toEqual([true, true]);
  expect(applied(DRAFT, keytimes(0, 1.5, 2)).clips[0]).toMatchObject({ set: true, confidence: [1, 1, 1] });
});

test("edits of a drag wait for its end, and are sent at once then", async () => {
  const server = new Server();
  const session = new DraftSession(server.rest, DRAFT);
  session.hold(true);
  session.edit(keytimes(0, 1.1, 2));
  session.edit(keytimes(0, 1.2, 2));
  await vi.advanceTimersByTimeAsync(5000);
  expect(session.draft.clips[0]?.keytimes).toEqual([0, 1.2, 2]);
  expect(server.calls).toHaveLength(0);
  session.hold(false);
  expect(server.calls.map(({ edit }) => edit)).toEqual([keytimes(0, 1.2, 2)]);
});
