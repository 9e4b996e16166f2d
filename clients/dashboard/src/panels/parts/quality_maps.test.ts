import { expect, test } from "vitest";
import { figuresText } from "./quality_maps";
import type { Quality } from "./slice";

const quality = {
  ...{ error_mean: 0.002, error_max: 0.01, smoothness_mean: 0.0012, smoothness_max: 0.02 },
  ...{ support_mean: 0.724, support_min: 0.413 },
} as Quality;
const unit = { text: "mm", factor: 1000 };

test.each([
  ["error", "mean 2, max 10 mm"],
  ["smoothness", "mean 0.0012, max 0.02"],
  ["support", "mean 72 %, min 41 %"],
] as const)("figures of the %s map: %s", (map, text) => {
  expect(figuresText(map, quality, unit)).toBe(text);
});

test("a map without values has a reason", () => {
  expect(figuresText("error", { ...quality, error_mean: null }, unit)).toBe("no measured goal");
});
