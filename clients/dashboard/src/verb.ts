/** Small questions about a verb's description. */

import type { Opened, Verb } from "./types";

/** Adverbs by name as numbers in the verb's order; empty where one is missing or of no use. */
export function inOrder(verb: Verb, goal: Readonly<Record<string, number>>): number[] {
  const values = verb.adverbs.map(({ name }) => goal[name] ?? Number.NaN);
  return values.every(Number.isFinite) ? values : [];
}

export function byName(verb: Verb, values: readonly number[]): Record<string, number> {
  return Object.fromEntries(verb.adverbs.map(({ name }, k) => [name, values[k] ?? 0]));
}

/** Where the goal is met: the phase of the effector's keytime; null where nothing is measured there. */
export function effectorPhase(verb: Verb): number | null {
  const { keytime } = verb.measure;
  const at = keytime === null ? -1 : verb.keytime_names.indexOf(keytime);
  return verb.keytime_phases[at] ?? null;
}

/** Where a held figure keeps its effector on a goal that moves; null where it does not. */
export function holdPhase(verb: Verb, opened: Opened | null): number | null {
  const phase = effectorPhase(verb);
  const [from, to] = opened?.verb === verb.name ? (opened.follow ?? []) : [];
  return phase !== null && from !== undefined && to !== undefined && phase >= from && phase <= to ? phase : null;
}

/** An error in words that fit its size: mm, or mm/s where velocity is measured. */
export function errorText(verb: Verb | null, error: number | null | undefined): string {
  if (error === null || error === undefined || Number.isNaN(error)) return "–";
  const mm = error * 1000;
  const digits = mm < 10 ? 2 : mm < 100 ? 1 : 0;
  return `${mm.toFixed(digits)} ${verb?.measure.unit === "m/s" ? "mm/s" : "mm"}`;
}
