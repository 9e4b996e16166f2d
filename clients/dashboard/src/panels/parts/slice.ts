/** A two-dimensional slice of adverb space; the other adverbs are fixed. */

import type { components } from "adverb-client";
import type { Verb, View } from "../../types";

export type Quality = components["schemas"]["QualityAnswer"];
type Named = Readonly<Record<string, number>>;
type Adverb = Verb["adverbs"][number];

/** Nodes per side; κ is comparable only between maps of one grid. */
export const NODES = 41;

const DIGITS = 3;

/** Examples are shown up to this distance from the slice, relative to a fixed adverb's range. */
const NEAR = 0.12;

export interface Slice {
  /** Equal to `up` if the verb has one adverb. */
  across: Adverb;
  up: Adverb;
  /** In the verb's order. */
  fixed: readonly (readonly [Adverb, number])[];
}

/** Slice with the named axes (default: the first two adverbs) and the fixed adverbs at `at` (default: mid-range). */
export function sliceOf(verb: Verb, names: { across: string; up: string }, at: Named): Slice | null {
  const { adverbs } = verb;
  const named = (name: string) => adverbs.find((adverb) => adverb.name === name);
  const namedUp = named(names.up);
  const across = named(names.across) ?? adverbs.find((adverb) => adverb !== namedUp) ?? adverbs[0];
  if (!across) return null;
  const up = namedUp && namedUp !== across ? namedUp : (adverbs.find((adverb) => adverb !== across) ?? across);
  const others = adverbs.filter((adverb) => adverb !== across && adverb !== up);
  return { across, up, fixed: others.map((adverb) => [adverb, within(adverb, at[adverb.name])] as const) };
}

function within({ min, max }: Adverb, value: number | undefined): number {
  return value === undefined ? (min + max) / 2 : Math.min(Math.max(value, min), max);
}

/** Path of the quality route for a slice and a method. */
export function qualityPath(verb: string, slice: Slice, method: string, version: number | null): string {
  const words = new URLSearchParams({ method, across: slice.across.name, up: slice.up.name, nodes: String(NODES) });
  const at = slice.fixed.map(([{ name }, value]) => `${name}=${value.toFixed(DIGITS)}`).join();
  if (at) words.set("at", at);
  if (version !== null) words.set("version", String(version));
  return `/v1/verbs/${encodeURIComponent(verb)}/quality?${words}`;
}

export interface Dot {
  across: number;
  up: number;
  /** 1 on the slice, 0 at the limit of visibility. */
  near: number;
}

/** The points near a slice. */
export function near(slice: Slice, points: readonly { adverbs: Named }[]): Dot[] {
  const dots = points.map(({ adverbs }) => {
    const apart = slice.fixed.map(
      ([{ name, min, max }, value]) => Math.abs((adverbs[name] ?? value) - value) / (max - min || 1),
    );
    return {
      across: adverbs[slice.across.name] ?? Number.NaN,
      up: adverbs[slice.up.name] ?? Number.NaN,
      near: 1 - Math.max(0, ...apart) / NEAR,
    };
  });
  return dots.filter((dot) => dot.near > 0 && Number.isFinite(dot.across) && Number.isFinite(dot.up));
}

/** Position of a value along a map's side, 0–1; nodes are cell centres. */
export function share({ min, max }: Adverb, value: number, nodes: number): number {
  return (((value - min) / (max - min || 1)) * (nodes - 1) + 0.5) / nodes;
}

/** Value at a position along a map's side; inverse of `share`. */
export function valueAt({ min, max }: Adverb, at: number, nodes: number): number {
  return min + Math.min(Math.max((at * nodes - 0.5) / (nodes - 1 || 1), 0), 1) * (max - min);
}

/** Map value at the nearest node; null outside the domain. */
export function lookUp(quality: Quality, key: View["map"], across: number, up: number): number | null {
  const { columns, rows } = quality;
  return quality[key][nearest(rows, up)]?.[nearest(columns, across)] ?? null;
}

function nearest(line: readonly number[], value: number): number {
  const [first = 0, last = 0] = [line[0], line.at(-1)];
  const k = Math.round(((value - first) / (last - first || 1)) * (line.length - 1));
  return Math.min(Math.max(k, 0), line.length - 1);
}
