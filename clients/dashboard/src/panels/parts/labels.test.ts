import { describe, expect, test } from "vitest";
import type { Refinement, Version } from "../../types";
import { adverbUnit, bytes, digits, errorText, errorUnit, kappa } from "../../units";
import { ageText, authorText, callerText, changeText, detailText, percent, qualityRows, stateText } from "./labels";

const refinement = (part: Partial<Refinement>) =>
  ({ detail: "", progress: {}, version_after: null, ...part }) as Refinement;

describe("state texts of refinements", () => {
  test.each<[string, Partial<Refinement>]>([
    ["Waiting for a worker", { state: "queued" }],
    ["0 pseudo-examples", { state: "running" }],
    ["1 pseudo-example, largest error 12 %", { state: "running", progress: { pseudo: 1, error_max: 0.1224 } }],
    ["34 pseudo-examples, largest error 0.95 %", { state: "running", progress: { pseudo: 34, error_max: 0.00952 } }],
    ["2 pseudo-examples, mean cost 0.713", { state: "running", progress: { pseudo: 2, cost_mean: 0.7134 } }],
    [
      "Target met; comparing with the current version",
      { state: "running", progress: { pseudo: 34, stopped: "target met" } },
    ],
    ["Published as version 4", { state: "published", version_after: 4 }],
    [
      "Kept as version 4, not activated",
      { state: "published", version_after: 4, detail: "kept as version 4, not activated: version 1 is current" },
    ],
    ["No improvement; version 3 stays", { version_before: 3, state: "not_better", detail: "not better: κ is higher" }],
    ["No improvement", { version_before: null, state: "not_better", detail: "the verb was deleted" }],
    ["Failed: no such blob", { state: "failed", detail: "no such blob" }],
    ["Abandoned: no worker finished it", { state: "given_up", detail: "no worker finished it" }],
    ["Failed", { state: "failed" }],
    ["Cancelled", { state: "cancelled" }],
  ])("%s", (text, part) => {
    expect(stateText(refinement(part))).toBe(text);
  });
});

test("the reason of a refinement without improvement is a detail", () => {
  expect(detailText(refinement({ state: "not_better", detail: "not better: κ is higher" }))).toBe("κ is higher");
  expect(detailText(refinement({ state: "failed", detail: "no such blob" }))).toBe("");
});

test("angles are shown in degrees, other adverbs in their unit", () => {
  expect(adverbUnit("rad")).toEqual({ text: "°", factor: 180 / Math.PI });
  expect(adverbUnit("rad/s").text).toBe("°/s");
  expect(adverbUnit("m")).toEqual({ text: "m", factor: 1 });
});

describe("texts of versions", () => {
  const version = (quality: object) => ({ quality }) as Version;

  test("a built version has one row per method", () => {
    const quality = { methods: { rbf: { error_mean_m: 0.05, error_max_m: 0.13 } } };
    expect(qualityRows(version(quality))).toEqual([{ method: "rbf", mean: 0.05, max: 0.13, kappa: null }]);
  });

  test("a refined version has the row of its evaluation", () => {
    const quality = { new: { method: "refined", error_mean_m: 0.003, error_max_m: 0.01, smoothness: 0.0026 }, now: {} };
    expect(qualityRows(version(quality))).toEqual([{ method: "refined", mean: 0.003, max: 0.01, kappa: 0.0026 }]);
  });

  test("a version without quality has no rows", () => {
    expect(qualityRows(version({}))).toEqual([]);
  });

  test("the author is a client or a refinement of the parent", () => {
    expect(authorText({ author: "a client", parent: null } as Version)).toBe("a client");
    expect(authorText({ author: "job 12ab", parent: 3 } as Version)).toBe("refinement of version 3");
  });
});

test.each([
  [0.4, "just now"],
  [60, "1 minute ago"],
  [7199, "1 hour ago"],
  [3 * 86_400, "3 days ago"],
])("%f seconds is %s", (seconds, text) => {
  expect(ageText(seconds)).toBe(text);
});

test("numbers have three significant digits", () => {
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

test("errors are in mm below 1 m and in m above; other units are kept", () => {
  expect(errorUnit("m", 0.02)).toEqual({ text: "mm", factor: 1000 });
  expect(errorUnit("m/s", 0.4)).toEqual({ text: "mm/s", factor: 1000 });
  expect(errorUnit("m", 1.2)).toEqual({ text: "m", factor: 1 });
  expect([errorText(0.226), errorText(0.00042), errorText(2.5), errorText(0.05, "m/s"), errorText(null)]).toEqual([
    "226 mm",
    "0.42 mm",
    "2.50 m",
    "50.0 mm/s",
    "–",
  ]);
  expect(errorUnit("rad", 0.4)).toEqual({ text: "rad", factor: 1 });
  expect(errorText(0.25, "SI")).toBe("0.25 (SI)");
});

test("changes are named by kind, verb and version", () => {
  const change = { id: 3, verb: "reach", kind: "activate", number: 2, current: 2, author: "", reason: "", at: 0 };
  expect(changeText(change)).toBe("Activated reach\u00a0v2");
  expect(changeText({ ...change, kind: "delete" })).toContain("Deleted reach");
  expect(changeText({ ...change, kind: "restore" })).toBe("restore: reach v2"); // of a newer server
});

test("a key is described by name, scopes and end", () => {
  const caller = { required: true, id: "9f3c", name: "", scopes: ["pose", "refine"], expires_at: null };
  expect(callerText(caller)).toBe("9f3c · pose, refine · does not expire");
  expect(callerText({ ...caller, name: "game", scopes: [] })).toContain("game · no scopes");
  expect(callerText({ ...caller, expires_at: 2e9 })).toMatch(/expires .*2033/);
  expect(callerText({ ...caller, required: false })).toBe("This server needs no key.");
});
