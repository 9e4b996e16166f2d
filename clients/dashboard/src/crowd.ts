/** Goals and phases of a crowd, spread over the convex hull of the examples and the motion; deterministic. */

import type { Verb } from "./types";

/** Steps of a two-dimensional low-discrepancy sequence: powers of the plastic number. */
const STEPS = [0.7548776662466927, 0.5698402909980532] as const;
/** Step of the phases: the golden ratio spreads any number of them evenly. */
const PHASE_STEP = 0.6180339887498949;

/** Phase at which character `k` starts while the first is at `phase`. */
export function crowdPhase(k: number, phase: number): number {
  return (phase + k * PHASE_STEP) % 1;
}

/**
 * Adverbs of each character in the verb's order. The first is the goal; the others are interpolated between two
 * examples.
 */
export function crowdGoals(verb: Verb, goal: readonly number[], characters: number): number[][] {
  const { examples, adverbs } = verb;
  const size = examples.length;
  return Array.from({ length: characters }, (_, k) => {
    if (k === 0 || size === 0) return [...goal];
    const pair = Math.floor(((k * STEPS[0]) % 1) * size * size);
    const [a, b] = [examples[pair % size], examples[Math.floor(pair / size) % size]];
    const share = (k * STEPS[1]) % 1;
    return adverbs.map(({ name }) => (1 - share) * (a?.adverbs[name] ?? 0) + share * (b?.adverbs[name] ?? 0));
  });
}
