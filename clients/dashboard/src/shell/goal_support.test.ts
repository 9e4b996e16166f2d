import { Emitter } from "adverb-client";
import { expect, test, vi } from "vitest";
import type { Page } from "../app";
import type { PoseRequest, Verb } from "../types";
import { goalSupport } from "./goal_support";

const verb = { name: "reach", version: 3, adverbs: [{ name: "x" }], skeleton: { names: ["Hips", "Hand"] } } as Verb;

/** A page whose pose requests are answered by the tests. */
function pageOf() {
  const emitter = new Emitter<{ verb: Verb; change: null }>();
  const requests: { request: PoseRequest; answer: (support: number) => void }[] = [];
  const view = { verb: "reach", goal: { x: 0.5 } as Record<string, number>, method: "" };
  const page = {
    verb,
    store: { view, on: (_: unknown, then: () => void) => emitter.on("change", then) },
    on: (_: "verb", then: (verb: Verb) => void) => emitter.on("verb", then),
    rest: {
      pose: (_: string, request: PoseRequest) =>
        new Promise((resolve) => requests.push({ request, answer: (support) => resolve({ support }) })),
    },
  };
  const support = goalSupport(page as unknown as Page);
  return { support, requests, view, emitter };
}

test("support of the goal is requested when a verb was loaded and when the goal changes", async () => {
  const { support, requests, view, emitter } = pageOf();
  emitter.emit("verb", verb);
  await vi.waitFor(() => expect(requests).toHaveLength(1));
  expect(requests[0]?.request).toEqual({ adverbs: { x: 0.5 }, joints: ["Hips"] });
  expect(support()).toBeNull();
  requests[0]?.answer(0.8);
  await vi.waitFor(() => expect(support()).toBe(0.8));
  Object.assign(view, { goal: { x: 0.6 }, method: "rbf" });
  emitter.emit("change", null);
  emitter.emit("change", null);
  await vi.waitFor(() => expect(requests).toHaveLength(2));
  expect(requests[1]?.request).toEqual({ adverbs: { x: 0.6 }, joints: ["Hips"], method: "rbf" });
});

test("support is unknown after the verb changed, and a late answer does not count", async () => {
  const { support, requests, emitter } = pageOf();
  emitter.emit("verb", verb);
  await vi.waitFor(() => expect(requests).toHaveLength(1));
  emitter.emit("verb", verb);
  requests[0]?.answer(0.8);
  await vi.waitFor(() => expect(requests).toHaveLength(2));
  expect(support()).toBeNull();
});
