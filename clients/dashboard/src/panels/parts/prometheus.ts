/** Prometheus' text form, read; quantiles of what happened between two scrapes. */

export type Labels = Readonly<Record<string, string>>;

export interface Sample {
  name: string;
  labels: Labels;
  value: number;
}

/** Cumulative counts of a histogram at the upper bounds of its buckets, which rise to infinity. */
export interface Buckets {
  bounds: readonly number[];
  counts: readonly number[];
  sum: number;
}

const LINE = /^([A-Za-z_:][\w:]*)(?:\{(.*)\})?\s+(\S+)(?:\s+-?\d+)?$/;
const LABEL = /([A-Za-z_]\w*)="((?:[^"\\]|\\.)*)"/g;
const ESCAPED: Record<string, string> = { "\\n": "\n", '\\"': '"', "\\\\": "\\" };

/** Samples of the metrics that are `wanted`; lines that are none are passed over. */
export function parse(text: string, wanted: (name: string) => boolean = () => true): Sample[] {
  const samples: Sample[] = [];
  for (const line of text.split("\n")) {
    if (line === "" || line.startsWith("#")) continue;
    const [, name, labels, value] = LINE.exec(line) ?? [];
    if (name === undefined || value === undefined || !wanted(name)) continue;
    samples.push({ name, labels: read(labels ?? ""), value: number(value) });
  }
  return samples;
}

function read(text: string): Labels {
  const labels: Record<string, string> = {};
  for (const [, name, value] of text.matchAll(LABEL))
    if (name !== undefined) labels[name] = (value ?? "").replace(/\\[n"\\]/g, (pair) => ESCAPED[pair] ?? pair);
  return labels;
}

function number(text: string): number {
  const sign = text.startsWith("-") ? -1 : 1;
  return /^[+-]?inf/i.test(text) ? sign * Number.POSITIVE_INFINITY : Number(text);
}

type Fits = (labels: Labels) => boolean;
const all: Fits = () => true;

/** Sum of a metric's samples; NaN where there is none. */
export function total(samples: readonly Sample[], name: string, fits: Fits = all): number {
  const found = samples.filter((sample) => sample.name === name && fits(sample.labels));
  return found.length > 0 ? found.reduce((sum, { value }) => sum + value, 0) : Number.NaN;
}

/** A histogram, added up over all labels that fit. */
export function buckets(samples: readonly Sample[], name: string, fits: Fits = all): Buckets {
  const counts = new Map<number, number>();
  for (const { name: each, labels, value } of samples) {
    if (each !== `${name}_bucket` || !fits(labels)) continue;
    const bound = number(labels.le ?? "");
    counts.set(bound, (counts.get(bound) ?? 0) + value);
  }
  const bounds = [...counts.keys()].sort((a, b) => a - b);
  return {
    bounds,
    counts: bounds.map((bound) => counts.get(bound) ?? 0),
    sum: total(samples, `${name}_sum`, fits) || 0,
  };
}

/** What came to a histogram since an earlier scrape; all of it where the server was started anew between them. */
export function since(now: Buckets, before: Buckets): Buckets {
  const was = new Map(before.bounds.map((bound, k) => [bound, before.counts[k] ?? 0]));
  const counts = now.bounds.map((bound, k) => (now.counts[k] ?? 0) - (was.get(bound) ?? 0));
  if (counts.some((count) => count < 0)) return now;
  return { bounds: now.bounds, counts, sum: now.sum - before.sum };
}

/** How many there are in a histogram. */
export function countOf({ counts }: Buckets): number {
  return counts.at(-1) ?? 0;
}

/** NaN where nothing happened. */
export function mean(of: Buckets): number {
  return countOf(of) > 0 ? of.sum / countOf(of) : Number.NaN;
}

/** A quantile, linear within its bucket; the last finite bound where it lies beyond, NaN where nothing happened. */
export function quantile({ bounds, counts }: Buckets, share: number): number {
  const wanted = share * (counts.at(-1) ?? 0);
  if (!(wanted > 0)) return Number.NaN;
  const k = counts.findIndex((count) => count >= wanted);
  const [from, to] = [bounds[k - 1] ?? 0, bounds[k] ?? Number.NaN];
  if (to === Number.POSITIVE_INFINITY) return from;
  const [below, upTo] = [counts[k - 1] ?? 0, counts[k] ?? 0];
  return from + ((wanted - below) / (upTo - below)) * (to - from);
}
