import { describe, expect, test } from "vitest";
import type { Refinement, Version } from "../../types";
import { ago, figuresOf, makerText, percent, stateText } from "./labels";
import { bytes, digits, errorUnit, kappa } from "./units";

const refinement = (part: Partial<Refinement>) =>
  ({ detail: "", progress: {}, version_after: null, ...part }) as Refinement;

describe("refinements in words", () => {
  test.each<[string, Partial<Refinement>]>([
    ["waiting for a worker", { state: "queued" }],
    ["0 pseudo-examples", { state: "running" }],
    ["1 pseudo-example, error at most 12 %", { state: "running", progress: { pseudo: 1, error_max: 0.1224 } }],
    ["34 pseudo-examples, error at most 0.95 %", { state: "running", progress: { pseudo: 34, error_max: 0.00952 } }],
    [
      "target met; comparing it with the version that is served",
      { state: "running", progress: { pseudo: 34, stopped: "target met" } },
    ],
    ["published as version 4", { state: "published", version_after: 4 }],
    ["not better: κ is higher", { state: "not_better", detail: "not better: κ is higher" }],
    ["not better: the verb was deleted", { state: "not_better", detail: "the verb was deleted" }],
    ["failed: no such blob", { state: "failed", detail: "no such blob" }],
    ["given up: no worker finished it", { state: "given_up", detail: "no worker finished it" }],
    ["failed", { state: "failed" }],
    ["cancelled", { state: "cancelled" }],
  ])("%s", (text, part) => {
    expect(stateText(refinement(part))).toBe(text);
  });
});

describe("versions in words", () => {
  const version = (quality: object) => ({ quality }) as Version;

  test("a built one has figures by method", () => {
    const told = { methods: { rbf: { error_mean_m: 0.05, error_max_m: 0.13 } } };
    expect(figuresOf(version(told))).toEqual([{ method: "rbf", mean: 0.05, max: 0.13, kappa: null }]);
  });

  test("a refined one has those that it was judged by", () => {
    const told = { new: { method: "refined", error_mean_m: 0.003, error_max_m: 0.01, smoothness: 0.0026 }, now: {} };
    expect(figuresOf(version(told))).toEqual([{ method: "refined", mean: 0.003, max: 0.01, kappa: 0.0026 }]);
  });

  test("one of which nothing is known has none", () => {
    expect(figuresOf(version({}))).toEqual([]);
  });

  test("its maker is a person, a file, or a refinement of another", () => {
    expect(makerText({ who: "a client", parent: null } as Version)).toBe("a client");
    expect(makerText({ who: "job 12ab", parent: 3 } as Version)).toBe("a refinement of version 3");
  });
});

test.each([
  [0.4, "just now"],
  [60, "1 minute ago"],
  [7199, "1 hour ago"],
  [3 * 86_400, "3 days ago"],
])("%f seconds ago is %s", (seconds, text) => {
  expect(ago(seconds)).toBe(text);
});

test("numbers have as many digits as they are worth", () => {
  expect([0, 1e-9, 0.1234, 7.5438, 42.26, 131.26, -0.7638].map((value) => digits(value))).toEqual([
    "0",
    "0",
    "0.123",
    "7.54",
    "42.3",
    "131",
    "−0.764",
  ]);
  expect([0, 0.0068344, 0.83, 3.4e-10, 1e-5].map(kappa)).toEqual(["0", "0.0068", "0.83", "3·10⁻¹⁰", "10⁻⁵"]);
  expect([digits(Number.NaN), kappa(null)]).toEqual(["–", "–"]);
  expect([512, 85_816, 2_505_496].map(bytes)).toEqual(["512 B", "85.8 kB", "2.51 MB"]);
  expect(percent(0.01)).toBe("1 %");
});

test("errors are written in mm or cm, of speeds too; other units stay", () => {
  expect(errorUnit("m", 0.02)).toEqual({ text: "mm", factor: 1000 });
  expect(errorUnit("m/s", 0.4)).toEqual({ text: "cm/s", factor: 100 });
  expect(errorUnit("rad", 0.4)).toEqual({ text: "rad", factor: 1 });
});
