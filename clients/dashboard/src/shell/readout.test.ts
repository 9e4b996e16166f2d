import { expect, test } from "vitest";
import type { Shown, Verb } from "../types";
import { comparisonText, goalState } from "./readout";

const verb = {
  ...{ keytime_names: ["start", "apex", "end"], keytime_phases: [0, 0.5, 1] },
  measure: { keytime: "apex", unit: "m" },
} as unknown as Verb;
const shown = (part: Partial<Shown>) => ({ error: 0, clamped: false, phase: 0.5, ...part }) as Shown;

test.each<[string, string, Partial<Shown>]>([
  ["reached", "Will reach the goal at apex", { phase: 0.1 }],
  ["reached", "Goal reached", { phase: 0.505 }],
  ["reached", "Reached the goal at apex", { phase: 0.9 }],
  ["missed", "Will miss the goal at apex", { phase: 0.1, error: 0.2 }],
  ["missed", "Goal missed", { error: 0.2 }],
  ["clamped", "Goal out of reach; moved to the nearest reachable point", { error: 0.2, clamped: true }],
  ["none", "No measured goal", { error: Number.NaN }],
])("the state is %s: %s", (state, text, part) => {
  expect(goalState(verb, shown(part))).toEqual({ state, text });
});

test("without a keytime the state describes the whole motion", () => {
  const walk = { ...verb, measure: { keytime: null, unit: "m/s" } } as unknown as Verb;
  expect(goalState(walk, shown({ phase: 0.1 })).text).toBe("The whole motion meets its goal");
});

test("a comparison is labelled with its method and error", () => {
  expect(comparisonText(verb, "RBF", 0.226)).toBe("RBF (comparison): 226 mm off");
  expect(comparisonText(verb, "RBF", Number.NaN)).toBe("RBF (comparison): no measured goal");
});
