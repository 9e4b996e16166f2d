import { describe, expect, test } from "vitest";
import type { Verb } from "../../types";
import { lookUp, near, type Quality, qualityPath, type Slice, share, sliceOf, valueAt } from "./slice";

const adverb = (name: string, min: number, max: number) => ({
  name,
  unit: "m",
  min,
  max,
  style: false,
  description: "",
});
const verb = (...adverbs: ReturnType<typeof adverb>[]) => ({ adverbs }) as unknown as Verb;
const reach = verb(adverb("x", -1, 1), adverb("y", 0, 2), adverb("z", 0.2, 0.8));
const none = { across: "", up: "" };

function slice(names: { across: string; up: string }, at = {}, of = reach): Slice {
  const found = sliceOf(of, names, at);
  if (!found) throw new Error("no slice");
  return found;
}

const axes = (found: Slice) => [found.across.name, found.up.name, ...found.fixed.map(([{ name }]) => name)];

describe("axes", () => {
  test("the first two adverbs are the default", () => {
    expect(axes(slice(none))).toEqual(["x", "y", "z"]);
  });

  test("a single name is completed with another adverb", () => {
    expect(axes(slice({ across: "z", up: "x" }))).toEqual(["z", "x", "y"]);
    expect(axes(slice({ across: "", up: "x" }))).toEqual(["y", "x", "z"]);
    expect(axes(slice({ across: "y", up: "" }))).toEqual(["y", "x", "z"]);
  });

  test("unknown and duplicate names are replaced", () => {
    expect(axes(slice({ across: "speed", up: "turn" }))).toEqual(["x", "y", "z"]);
    expect(axes(slice({ across: "y", up: "y" }))).toEqual(["y", "x", "z"]);
  });

  test("a single adverb is on both axes", () => {
    expect(axes(slice(none, {}, verb(adverb("speed", 0, 3))))).toEqual(["speed", "speed"]);
    expect(sliceOf(verb(), none, {})).toBeNull();
  });
});

describe("queries", () => {
  test("fixed adverbs are clamped to their range and default to mid-range", () => {
    const path = qualityPath("reach", slice(none, { z: 0.41 }), "rbf", null);
    expect(decodeURIComponent(path)).toBe("/v1/verbs/reach/quality?method=rbf&across=x&up=y&nodes=41&at=z=0.410");
    expect(slice(none, { z: 9 }).fixed[0]?.[1]).toBe(0.8);
    expect(slice(none).fixed[0]?.[1]).toBeCloseTo(0.5);
  });

  test("names are escaped and the version is included if given", () => {
    const path = qualityPath("a/b c", slice(none, {}, verb(adverb("x&y", 0, 1), adverb("ü", 0, 1))), "knn", 3);
    expect(path.startsWith("/v1/verbs/a%2Fb%20c/quality?")).toBe(true);
    const words = new URL(path, "http://x").searchParams;
    expect(Object.fromEntries(words)).toEqual({ method: "knn", across: "x&y", up: "ü", nodes: "41", version: "3" });
  });
});

describe("points", () => {
  const at = (x: number, y: number, z: number) => ({ adverbs: { x, y, z } });

  test("points far from the slice are omitted, others fade with distance", () => {
    const dots = near(slice(none, { z: 0.5 }), [at(0, 1, 0.5), at(0.5, 1, 0.536), at(0, 0, 0.7)]);
    expect(dots.map((dot) => dot.across)).toEqual([0, 0.5]);
    expect(dots.map((dot) => dot.near)).toEqual([1, expect.closeTo(0.5)]);
  });

  test("share and valueAt are inverse", () => {
    const { across } = slice(none);
    for (const value of [-1, -0.3, 0, 1]) expect(valueAt(across, share(across, value, 41), 41)).toBeCloseTo(value);
    expect(valueAt(across, 0, 41)).toBe(-1);
    expect(share(across, -1, 41)).toBeCloseTo(0.5 / 41);
  });

  test("lookUp returns the nearest node's value, and null outside the domain", () => {
    const quality = {
      columns: [-1, 0, 1],
      rows: [0, 2],
      error: [
        [1, 2, 3],
        [4, null, 6],
      ],
    } as unknown as Quality;
    expect(lookUp(quality, "error", 0.9, 0.4)).toBe(3);
    expect(lookUp(quality, "error", 0.1, 1.9)).toBeNull();
    expect(lookUp(quality, "error", -5, 9)).toBe(4);
  });
});
