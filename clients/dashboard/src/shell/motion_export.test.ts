import { expect, test } from "vitest";
import type { Page } from "../app";
import type { Verb, View } from "../types";
import { wantedOf } from "./motion_export";

const verb = { name: "reach", adverbs: [{ name: "x" }, { name: "y" }] } as Verb;
const wanted = (known: Verb | null, view: Partial<View>) =>
  wantedOf({ verb: known, store: { view } } as unknown as Page);

test("the request has the goal in view and the chosen method", () => {
  const view = { verb: "reach", goal: { y: 1.2, x: -0.3, other: 4 }, method: "" };
  expect(wanted(verb, view)).toEqual(["reach", { adverbs: { x: -0.3, y: 1.2 }, fps: 30 }]);
  expect(wanted(verb, { ...view, method: "rbf" })?.[1].method).toBe("rbf");
});

test("there is none before the verb and its goal are known", () => {
  expect(wanted(null, { verb: "reach", goal: { x: 0, y: 0 } })).toBeNull();
  expect(wanted(verb, { verb: "punch", goal: { x: 0, y: 0 } })).toBeNull();
  expect(wanted(verb, { verb: "reach", goal: { x: 0 } })).toBeNull();
});
