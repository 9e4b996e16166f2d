/** Parser of the Prometheus text format, and quantiles between two scrapes. */

export type Labels = Readonly<Record<string, string>>;

export interface Sample {
  name: string;
  labels: Labels;
  value: number;
}

/** Cumulative histogram counts at ascending upper bounds, the last one infinite. */
export interface Buckets {
  bounds: readonly number[];
  counts: readonly number[];
  sum: number;
}

const LINE = /^([A-Za-z_:][\w:]*)(?:\{(.*)\})?\s+(\S+)(?:\s+-?\d+)?$/;
const LABEL = /([A-Za-z_]\w*)="((?:[^"\\]|\\.)*)"/g;
const ESCAPED: Record<string, string> = { "\\n": "\n", '\\"': '"', "\\\\": "\\" };

/** Parse samples whose metric name is `wanted`; other lines are skipped. */
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

/** Sum of a metric's samples; NaN if there are none. */
export function total(samples: readonly Sample[], name: string, fits: Fits = all): number {
  const found = samples.filter((sample) => sample.name === name && fits(sample.labels));
  return found.length > 0 ? found.reduce((sum, { value }) => sum + value, 0) : Number.NaN;
}

/** Histogram summed over all matching labels. */
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

/** Increase of a histogram since an earlier scrape; the whole histogram after a server restart. */
export function since(now: Buckets, before: Buckets): Buckets {
  const was = new Map(before.bounds.map((bound, k) => [bound, before.counts[k] ?? 0]));
  const counts = now.bounds.map((bound, k) => (now.counts[k] ?? 0) - (was.get(bound) ?? 0));
  if (counts.some((count) => count < 0)) return now;
  return { bounds: now.bounds, counts, sum: now.sum - before.sum };
}

/** Total count of a histogram. */
export function countOf({ counts }: Buckets): number {
  return counts.at(-1) ?? 0;
}

/** Mean value; NaN for an empty histogram. */
export function mean(of: Buckets): number {
  return countOf(of) > 0 ? of.sum / countOf(of) : Number.NaN;
}

/** Quantile, linear within its bucket. Returns the last finite bound beyond it, NaN for an empty histogram. */
export function quantile({ bounds, counts }: Buckets, fraction: number): number {
  const rank = fraction * (counts.at(-1) ?? 0);
  if (!(rank > 0)) return Number.NaN;
  const k = counts.findIndex((count) => count >= rank);
  const [from, to] = [bounds[k - 1] ?? 0, bounds[k] ?? Number.NaN];
  if (to === Number.POSITIVE_INFINITY) return from;
  const [below, upTo] = [counts[k - 1] ?? 0, counts[k] ?? 0];
  return from + ((rank - below) / (upTo - below)) * (to - from);
}
