/** Adverbs by name and in the verb's order. */

import { BadRequest, UnknownName } from "./errors.js";
import { CHARTS, type Chart, fromChart } from "./math/chart.js";
import type { Verb } from "./schema.js";

/**
 * All adverbs in the verb's order; those that are not named have the values of `known`, by default the middle of the
 * domain.
 *
 * @throws UnknownName the verb has no adverb of a name
 * @throws BadRequest a value is not finite
 */
export function completeAdverbs(
  verb: Verb,
  named: Readonly<Record<string, number>>,
  known: readonly number[] = middleOf(verb),
): number[] {
  const names = verb.adverbs.map(({ name }) => name);
  for (const [name, value] of Object.entries(named)) {
    if (!names.includes(name))
      throw new UnknownName(0, "unknown_adverb", `unknown adverb ${name}; there are ${names.join(", ")}`, names);
    if (!Number.isFinite(value)) throw new BadRequest(0, "out_of_range", `adverb '${name}' is ${value}`);
  }
  return names.map((name, k) => named[name] ?? (known[k] as number));
}

/** Adverbs by name. */
export function namedAdverbs(verb: Verb, values: readonly number[]): Record<string, number> {
  return Object.fromEntries(verb.adverbs.map(({ name }, k) => [name, values[k] as number]));
}

/** Adverbs in the middle of the domain. */
export function middleOf({ domain }: Verb): number[] {
  const { chart_axes: axes, chart_bend: bend, shift, scale, middle } = domain;
  const chart: Chart = { kind: CHARTS.indexOf(domain.chart), axes, bend, shift, scale };
  const out = new Float64Array(middle.length);
  fromChart(chart, Float64Array.from(middle), out);
  return [...out];
}
