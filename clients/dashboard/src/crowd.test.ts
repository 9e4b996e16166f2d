import { expect, test } from "vitest";
import { crowdGoals } from "./crowd";
import type { Verb } from "./types";

/** Two adverbs, examples on the corners of a square of side 2. */
const verb = {
  adverbs: [{ name: "x" }, { name: "y" }],
  examples: [-1, 1].flatMap((x) => [-1, 1].map((y) => ({ adverbs: { x, y } }))),
} as unknown as Verb;

test("the first goal is the given one, the others are spread over the examples' hull", () => {
  const goals = crowdGoals(verb, [0.25, 0.5], 1000);
  expect(goals).toHaveLength(1000);
  expect(goals[0]).toEqual([0.25, 0.5]);
  for (const goal of goals) for (const value of goal) expect(Math.abs(value)).toBeLessThanOrEqual(1);
  const quadrants = new Set(goals.map(([x = 0, y = 0]) => `${x > 0.5} ${x < -0.5} ${y > 0.5} ${y < -0.5}`));
  expect(quadrants.size).toBeGreaterThanOrEqual(8);
  expect(new Set(goals.map((goal) => goal.join())).size).toBeGreaterThan(700);
});

test("a growing crowd keeps its first goals", () => {
  expect(crowdGoals(verb, [0, 0], 500).slice(0, 20)).toEqual(crowdGoals(verb, [0, 0], 20));
});
