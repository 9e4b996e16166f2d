import { expect, test } from "vitest";
import type { App, Refinement, View } from "../../types";
import { figureRows, otherVersion, playGoal, type QualityFigures, qualityFigures } from "./refinement_figures";

const figures: QualityFigures = {
  for: "quality",
  now: { method: "corrected", peak_p95_m_s2: 432.2, range_p95_rad: 0.2865, slide_p90_m: null, cost_mean: 1.46 },
  new: { method: "corrected", peak_p95_m_s2: 228.9, range_p95_rad: 0.1885, slide_p90_m: null, cost_mean: 0.69 },
  goals: 200,
  better_ratio: 0.56,
  worse_ratio: 0.08,
  worst: [],
};

const refinement = (part: Partial<Refinement>) =>
  ({ progress: {}, version_before: 1, version_after: 2, ...part }) as Refinement;

test("figures stand before and after, without those that a verb does not have", () => {
  expect(figureRows(figures)).toEqual([
    ["Peak acceleration, p95, m/s²", "432", "229"],
    ["Joint beyond the examples, p95, °", "16.4", "10.8"],
    ["Mean cost", "1.46", "0.69"],
  ]);
});

test("only evaluated refinements for quality have figures", () => {
  expect(qualityFigures(refinement({ progress: { figures } }))).toEqual(figures);
  expect(qualityFigures(refinement({ progress: { figures: { now: {}, new: {} } } }))).toBeNull();
  expect(qualityFigures(refinement({}))).toBeNull();
});

test("the version beside is the one that is not served", () => {
  expect(otherVersion(refinement({}), 2)).toBe(1);
  expect(otherVersion(refinement({}), 1)).toBe(2);
  expect(otherVersion(refinement({ version_after: null }), 1)).toBeNull();
});

test("a worst goal is played from its start beside the other version", () => {
  const changes: Partial<View>[] = [];
  const store = { change: (part: Partial<View>) => changes.push(part) };
  playGoal({ verb: { version: 2 }, store } as unknown as App, refinement({}), { x: 0.5 });
  playGoal({ verb: { version: 1 }, store } as unknown as App, refinement({ version_after: null }), { x: 0.5 });
  const motion = { goal: { x: 0.5 }, method: "", phase: 0, playing: true, loop: true };
  expect(changes).toEqual([
    { ...motion, compare: { kind: "version", version: 1 } },
    { ...motion, compare: { kind: "none" } },
  ]);
});
