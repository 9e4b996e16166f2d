/** A plane through the space of adverbs: two of them on the axes, the others held. */

import type { components } from "../../generated/schema";
import type { Verb } from "../../types";

export type Quality = components["schemas"]["QualityAnswer"];
type Named = Readonly<Record<string, number>>;
type Adverb = Verb["adverbs"][number];

/** Nodes to a side; κ is only comparable between maps of one grid. */
export const NODES = 41;

const DIGITS = 3;

/** Examples that are further from the slice than this share of a held adverb's range are not shown with it. */
const NEAR = 0.12;

export interface Slice {
  /** The same adverb twice where the verb has but one. */
  across: Adverb;
  up: Adverb;
  /** In the verb's order. */
  held: readonly (readonly [Adverb, number])[];
}

/** The slice whose axes are named, or the first adverbs, at the held adverbs' values in `at`, or at mid-range. */
export function sliceOf(verb: Verb, names: { across: string; up: string }, at: Named): Slice | null {
  const { adverbs } = verb;
  const named = (name: string) => adverbs.find((adverb) => adverb.name === name);
  const wanted = named(names.up);
  const across = named(names.across) ?? adverbs.find((adverb) => adverb !== wanted) ?? adverbs[0];
  if (!across) return null;
  const up = wanted && wanted !== across ? wanted : (adverbs.find((adverb) => adverb !== across) ?? across);
  const others = adverbs.filter((adverb) => adverb !== across && adverb !== up);
  return { across, up, held: others.map((adverb) => [adverb, within(adverb, at[adverb.name])] as const) };
}

function within({ min, max }: Adverb, value: number | undefined): number {
  return value === undefined ? (min + max) / 2 : Math.min(Math.max(value, min), max);
}

/** Where the server tells a method's maps over a slice; of the current version unless another is named. */
export function qualityPath(verb: string, slice: Slice, method: string, version: number | null): string {
  const words = new URLSearchParams({ method, across: slice.across.name, up: slice.up.name, nodes: String(NODES) });
  const at = slice.held.map(([{ name }, value]) => `${name}=${value.toFixed(DIGITS)}`).join();
  if (at) words.set("at", at);
  if (version !== null) words.set("version", String(version));
  return `/v1/verbs/${encodeURIComponent(verb)}/quality?${words}`;
}

export interface Dot {
  across: number;
  up: number;
  /** 1 on the slice, 0 where it is too far away to be shown. */
  near: number;
}

/** Those of some points in adverb space that lie near a slice. */
export function near(slice: Slice, points: readonly { adverbs: Named }[]): Dot[] {
  const dots = points.map(({ adverbs }) => {
    const apart = slice.held.map(
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

/** Where a value lies among a map's nodes, as a share of its side; nodes are the middles of cells. */
export function share({ min, max }: Adverb, value: number, nodes: number): number {
  return (((value - min) / (max - min || 1)) * (nodes - 1) + 0.5) / nodes;
}

/** The value at a share of a map's side. */
export function valueAt({ min, max }: Adverb, at: number, nodes: number): number {
  return min + Math.min(Math.max((at * nodes - 0.5) / (nodes - 1 || 1), 0), 1) * (max - min);
}

/** What a map says at a place; null outside the domain. */
export function lookUp(quality: Quality, key: "error" | "smoothness", across: number, up: number): number | null {
  const { columns, rows } = quality;
  return quality[key][nearest(rows, up)]?.[nearest(columns, across)] ?? null;
}

function nearest(line: readonly number[], value: number): number {
  const [first = 0, last = 0] = [line[0], line.at(-1)];
  const k = Math.round(((value - first) / (last - first || 1)) * (line.length - 1));
  return Math.min(Math.max(k, 0), line.length - 1);
}
