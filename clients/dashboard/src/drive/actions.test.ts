import { expect, test } from "vitest";
import type { Verb } from "../types";
import { type Action, Actions, actionGoal, releasePhase, sameSkeleton } from "./actions";

const JUMP = {
  name: "jump",
  keytime_phases: [0, 0.3, 0.5, 0.7, 1],
  measure: { kind: "jump", adverbs: ["distance", "direction", "height"] },
  adverbs: [
    { name: "distance", min: 0, max: 1.6 },
    { name: "direction", min: -1.6, max: 1.6 },
    { name: "height", min: 0.1, max: 0.3 },
  ],
  examples: [],
} as unknown as Verb;
const PUNCH = {
  name: "punch",
  keytime_phases: [0, 0.4, 1],
  measure: { kind: "joint_position", adverbs: ["x", "y"] },
  adverbs: [{ name: "x" }, { name: "y" }],
  examples: [-1, 1].flatMap((x) => [-1, 1].map((y) => ({ adverbs: { x, y } }))),
} as unknown as Verb;

const action = (verb: Verb): Action => ({ verb, adverbs: [] });

test("a jump goes where the character moves, as far as its range allows", () => {
  expect(actionGoal(JUMP, [0, 0], 0)).toEqual([0, 0, 0.2]);
  expect(actionGoal(JUMP, [2, 0], 1)[0]).toBeCloseTo(0.9);
  expect(actionGoal(JUMP, [9, 0], 1)[0]).toBe(1.6);
  expect(actionGoal(JUMP, [0, 1], 1)[1]).toBeCloseTo(Math.PI / 2);
  expect(actionGoal(JUMP, [-1, 0], 1)[0]).toBe(0);
});

test("goals of other actions vary within the examples", () => {
  const goals = [0, 1, 2, 3].map((count) => actionGoal(PUNCH, [1, 0], count));
  expect(new Set(goals.map(String)).size).toBe(4);
  for (const value of goals.flat()) expect(Math.abs(value)).toBeLessThanOrEqual(1);
});

test("an action lasts until its end; one more is kept", () => {
  const actions = new Actions();
  for (const verb of [JUMP, PUNCH, JUMP]) actions.request(() => action(verb));
  expect(actions.current?.verb).toBe(JUMP);
  actions.end();
  expect(actions.current?.verb).toBe(JUMP);
  actions.end();
  expect(actions.current).toBeNull();
});

test("steering ends an action only after it has recovered", () => {
  expect(releasePhase(PUNCH)).toBeCloseTo(0.61);
  const actions = new Actions();
  actions.request(() => action(PUNCH));
  actions.shown("locomotion", 0.9, true);
  actions.shown("punch", 0.9, true); // not begun: a phase of the verb before
  actions.shown("punch", 0.6, true);
  actions.shown("punch", 0.7, false);
  expect(actions.current?.verb).toBe(PUNCH);
  actions.shown("punch", 0.72, true);
  expect(actions.current).toBeNull();
});

test("skeletons are equal if names and parents are", () => {
  const body = { names: ["Hips", "Spine"], parents: [-1, 0] };
  expect(sameSkeleton(body, structuredClone(body))).toBe(true);
  expect(sameSkeleton(body, { ...body, names: ["Hips", "Chest"] })).toBe(false);
});
