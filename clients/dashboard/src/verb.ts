/** Queries on a verb's description. */

import type { Opened, Verb } from "./types";

/** Adverb values in the verb's order; empty if one is missing or not finite. */
export function adverbValues(verb: Verb, goal: Readonly<Record<string, number>>): number[] {
  const values = verb.adverbs.map(({ name }) => goal[name] ?? Number.NaN);
  return values.every(Number.isFinite) ? values : [];
}

export function adverbsByName(verb: Verb, values: readonly number[]): Record<string, number> {
  return Object.fromEntries(verb.adverbs.map(({ name }, k) => [name, values[k] ?? 0]));
}

/** Phase of the goal's keytime; null if the verb has none. */
export function effectorPhase(verb: Verb): number | null {
  const { keytime } = verb.measure;
  const at = keytime === null ? -1 : verb.keytime_names.indexOf(keytime);
  return verb.keytime_phases[at] ?? null;
}

/** Phase at which a paused figure tracks a moving goal; null if it does not. */
export function followPhase(verb: Verb, opened: Opened | null): number | null {
  const phase = effectorPhase(verb);
  const [from, to] = opened?.verb === verb.name ? (opened.follow ?? []) : [];
  return phase !== null && from !== undefined && to !== undefined && phase >= from && phase <= to ? phase : null;
}
