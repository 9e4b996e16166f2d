/** Charts of the last five minutes. */

import { h } from "../../shell/dom";
import { digits } from "../../units";
import { Chart, type ChartLook, type Line } from "./chart";
import type { ServerMetrics } from "./server_metrics";

const WINDOW_S = 300;
const MINUTE_S = 60;
const QUARTER_S = 15;
/** A longer gap between two samples breaks the line. */
const GAP_S = 7;

const QUANTILES: readonly Line[] = [
  { label: "p50", colour: "--quiet" },
  { label: "p95", colour: "--accent" },
  { label: "p99", colour: "--warn" },
];
const SERIES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5"];

interface Row {
  chart: Chart;
  columns: readonly ((metrics: ServerMetrics) => number)[];
}

export class History {
  readonly element = h("div", { className: "history" });
  private readonly errors = h("div", {});
  private readonly rows: Row[];
  private verbs: readonly string[] = [];
  private verbRow: Row | null = null;
  private past: ServerMetrics[] = [];

  constructor() {
    this.rows = [
      late("REST latency", (metrics) => metrics.requests),
      late("Frame lateness", (metrics) => metrics.frameLateness),
      row("Pose messages", ["sent", "--accent", "framesPerS"], ["dropped", "--bad", "droppedPerS"], "/s"),
      row("Poses evaluated", ["poses", "--accent", "posesPerS"], null, "/s"),
      row("Characters and streams", ["characters", "--accent", "characters"], ["streams", "--quiet", "streams"], ""),
      late("Event loop lateness", (metrics) => metrics.loopLateness),
    ];
    this.element.append(...this.rows.map(({ chart }) => chart.element), this.errors);
  }

  add(metrics: ServerMetrics): void {
    this.past = [...this.past.filter(({ atS }) => atS > metrics.atS - WINDOW_S), metrics];
    const verbs = [
      ...new Set(
        this.past.flatMap(({ errors }) =>
          [...errors].filter(([, value]) => !Number.isNaN(value)).map(([verb]) => verb),
        ),
      ),
    ];
    if (verbs.sort().join() !== this.verbs.join()) this.anew(verbs);
    const { across, points } = placed(this.past);
    for (const { chart, columns } of [...this.rows, ...(this.verbRow ? [this.verbRow] : [])])
      chart.show(
        across,
        columns.map((of) => points.map((point) => (point === null ? null : known(of(point))))),
      );
  }

  dispose(): void {
    for (const { chart } of this.rows) chart.dispose();
    this.verbRow?.chart.dispose();
  }

  /** Rebuild the error chart when its set of verbs changes. */
  private anew(verbs: readonly string[]): void {
    this.verbs = verbs;
    this.verbRow?.chart.dispose();
    const lines = verbs.map((verb, k) => ({
      label: verb,
      colour: SERIES[k % SERIES.length] ?? "--accent",
      ...(k >= SERIES.length && { dash: [4, 3] }),
    }));
    const poll = {
      title: "Mean error by verb, mm",
      lines,
      format: inMm,
      tick: (value: number) => digits(value * 1000),
      least: 0.001,
    };
    const columns = verbs.map(
      (verb) =>
        ({ errors }: ServerMetrics) =>
          errors.get(verb) ?? Number.NaN,
    );
    this.verbRow = { chart: new Chart({ ...poll, across: minutes }), columns };
    this.errors.replaceChildren(this.verbRow.chart.element);
  }
}

/** X values in seconds before the newest sample; null marks a gap. */
function placed(past: readonly ServerMetrics[]): { across: number[]; points: (ServerMetrics | null)[] } {
  const now = past.at(-1)?.atS ?? 0;
  const [across, points]: [number[], (ServerMetrics | null)[]] = [[], []];
  past.forEach((metrics, k) => {
    const before = past[k - 1];
    if (before && metrics.atS - before.atS > GAP_S) {
      across.push((before.atS + metrics.atS) / 2 - now);
      points.push(null);
    }
    across.push(metrics.atS - now);
    points.push(metrics);
  });
  return { across, points };
}

/** The window grows with the data up to its full width. */
const minutes: ChartLook["across"] = {
  range: (_, first) => [-Math.min(Math.max(-first, MINUTE_S), WINDOW_S), 0],
  splits: (_, __, first) => {
    const step = first < -2 * MINUTE_S ? MINUTE_S : QUARTER_S;
    return Array.from({ length: Math.floor(-first / step) }, (___, k) => -k * step).reverse();
  },
  values: (_, ticks) => ticks.map(agoText),
};

function agoText(seconds: number): string {
  if (seconds === 0) return "now";
  return seconds % MINUTE_S === 0 ? `−${-seconds / MINUTE_S} min` : `−${-seconds} s`;
}

function late(title: string, of: (metrics: ServerMetrics) => readonly number[]): Row {
  const poll = {
    title,
    lines: QUANTILES,
    format: inMs,
    tick: (value: number) => `${digits(value * 1000)}`,
    least: 0.001,
  };
  const columns = QUANTILES.map((_, k) => (metrics: ServerMetrics) => of(metrics)[k] ?? Number.NaN);
  return { chart: new Chart({ ...poll, title: `${title}, ms`, across: minutes }), columns };
}

type Key = "framesPerS" | "droppedPerS" | "posesPerS" | "streams" | "characters";
type SeriesSpec = readonly [label: string, colour: string, key: Key];

function row(title: string, first: SeriesSpec, second: SeriesSpec | null, unit: string): Row {
  const specs = second ? [first, second] : [first];
  const lines = specs.map(([label, colour]) => ({ label, colour }));
  const format = (value: number | null | undefined) =>
    value === null || value === undefined ? "–" : `${short(value)}${unit}`;
  const poll = { title, lines, format, tick: short, least: 1 };
  return {
    chart: new Chart({ ...poll, across: minutes }),
    columns: specs.map(
      ([, , key]) =>
        (metrics) =>
          metrics[key],
    ),
  };
}

function known(value: number): number | null {
  return Number.isFinite(value) ? value : null;
}

function inMs(seconds: number | null | undefined): string {
  return seconds === null || seconds === undefined ? "–" : digits(seconds * 1000);
}

function inMm(metres: number | null | undefined): string {
  return metres === null || metres === undefined ? "–" : digits(metres * 1000);
}

/** Thousands as k, for the narrow axis. */
export function short(value: number): string {
  if (value >= 1e6) return `${digits(value / 1e6)} M`;
  return value >= 10_000 ? `${digits(value / 1000)} k` : digits(value);
}
