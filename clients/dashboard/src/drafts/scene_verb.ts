/** What the scene needs of a draft's verb, also while the clips make none. */

import type { Verb } from "../types";
import type { Draft, DraftMotion } from "./types";

/** Phases of the keytimes: those of the verb, or equal parts. */
export function phasesOf(draft: Draft): readonly number[] {
  const count = draft.keytime_names.length;
  const known = draft.verb?.keytime_phases;
  if (known?.length === count) return known;
  return draft.keytime_names.map((_, k) => k / Math.max(count - 1, 1));
}

/** The draft's verb, or its skeleton alone. */
export function sceneVerb(draft: Draft, { skeleton }: DraftMotion): Verb {
  if (draft.verb) return draft.verb;
  const measure = {
    kind: "none",
    effector: draft.effector,
    keytime: null,
    adverbs: [],
    unit: "m",
    origin: null,
    frame: null,
  };
  return {
    ...{ name: draft.name, version: draft.revision, description: "", looping: draft.looping, adverbs: [], skeleton },
    ...{ examples: [], pseudo_examples: [], keytime_names: [...draft.keytime_names], contacts: [], quality: {} },
    ...{ keytime_phases: [...phasesOf(draft)], duration: { min: 2, max: 2 }, methods: [], default_method: "", measure },
    domain: { text: "", chart: "", chart_axes: [], chart_bend: [], shift: [], scale: [], facets: [], middle: [] },
  } as Verb;
}

/** A goal in the domain: halfway between the most central example and its neighbour. */
export function centralGoal({ adverbs, examples }: Verb): Record<string, number> {
  const spans = adverbs.map(({ min, max }) => max - min || 1);
  const rows = examples.map((one) => adverbs.map(({ name }) => one.adverbs[name] ?? 0));
  const mean = adverbs.map((_, d) => rows.reduce((sum, row) => sum + (row[d] as number), 0) / Math.max(rows.length, 1));
  const away = (a: readonly number[], b: readonly number[]) =>
    Math.hypot(...a.map((value, d) => (value - (b[d] as number)) / (spans[d] as number)));
  const nearest = (to: readonly number[], among: readonly (readonly number[])[]) =>
    among.reduce((best, row) => (away(row, to) < away(best, to) ? row : best), among[0] ?? to);
  const centre = nearest(mean, rows);
  const other = nearest(
    centre,
    rows.filter((row) => row !== centre),
  );
  const middle = (d: number) => ((centre[d] as number) + (other[d] as number)) / 2;
  return Object.fromEntries(adverbs.map(({ name }, d) => [name, Math.round(1e4 * middle(d)) / 1e4]));
}
