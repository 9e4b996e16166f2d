/** Charts of the last five minutes. */

import { h } from "../../shell/dom";
import { Chart, type ChartLook, type Line } from "./chart";
import type { Measures } from "./server_metrics";
import { digits } from "./units";

const WINDOW_S = 300;
const MINUTE_S = 60;
const QUARTER_S = 15;
/** Where two points are further apart the line is broken. */
const GAP_S = 7;

const QUANTILES: readonly Line[] = [
  { label: "p50", colour: "--quiet" },
  { label: "p95", colour: "--accent" },
  { label: "p99", colour: "--warn" },
];
const SERIES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5"];

interface Row {
  chart: Chart;
  columns: readonly ((measures: Measures) => number)[];
}

export class History {
  readonly element = h("div", { className: "history" });
  private readonly errors = h("div", {});
  private readonly rows: Row[];
  private verbs: readonly string[] = [];
  private verbRow: Row | null = null;
  private past: Measures[] = [];

  constructor() {
    this.rows = [
      late("REST latency", (measures) => measures.requests),
      late("Frame lateness", (measures) => measures.frameLateness),
      row("Pose messages", ["sent", "--accent", "framesPerS"], ["dropped", "--bad", "droppedPerS"], "/s"),
      row("Poses evaluated", ["poses", "--accent", "posesPerS"], null, "/s"),
      row("Characters and streams", ["characters", "--accent", "characters"], ["streams", "--quiet", "streams"], ""),
      late("Event loop lateness", (measures) => measures.loopLateness),
    ];
    this.element.append(...this.rows.map(({ chart }) => chart.element), this.errors);
  }

  add(measures: Measures): void {
    this.past = [...this.past.filter(({ atS }) => atS > measures.atS - WINDOW_S), measures];
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

  /** Other verbs are asked for than before. */
  private anew(verbs: readonly string[]): void {
    this.verbs = verbs;
    this.verbRow?.chart.dispose();
    const lines = verbs.map((verb, k) => ({
      label: verb,
      colour: SERIES[k % SERIES.length] ?? "--accent",
      ...(k >= SERIES.length && { dash: [4, 3] }),
    }));
    const look = {
      title: "Mean error by verb, mm",
      lines,
      say: inMm,
      tick: (value: number) => digits(value * 1000),
      least: 0.001,
    };
    const columns = verbs.map(
      (verb) =>
        ({ errors }: Measures) =>
          errors.get(verb) ?? Number.NaN,
    );
    this.verbRow = { chart: new Chart({ ...look, across: minutes }), columns };
    this.errors.replaceChildren(this.verbRow.chart.element);
  }
}

/** Seconds before the newest point, with a hole where nothing was scraped for a while. */
function placed(past: readonly Measures[]): { across: number[]; points: (Measures | null)[] } {
  const now = past.at(-1)?.atS ?? 0;
  const [across, points]: [number[], (Measures | null)[]] = [[], []];
  past.forEach((measures, k) => {
    const before = past[k - 1];
    if (before && measures.atS - before.atS > GAP_S) {
      across.push((before.atS + measures.atS) / 2 - now);
      points.push(null);
    }
    across.push(measures.atS - now);
    points.push(measures);
  });
  return { across, points };
}

/** The window grows with what there is to see, up to its full width. */
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

function late(title: string, of: (measures: Measures) => readonly number[]): Row {
  const look = { title, lines: QUANTILES, say: inMs, tick: (value: number) => `${digits(value * 1000)}`, least: 0.001 };
  const columns = QUANTILES.map((_, k) => (measures: Measures) => of(measures)[k] ?? Number.NaN);
  return { chart: new Chart({ ...look, title: `${title}, ms`, across: minutes }), columns };
}

type Key = "framesPerS" | "droppedPerS" | "posesPerS" | "streams" | "characters";
type Told = readonly [label: string, colour: string, key: Key];

function row(title: string, first: Told, second: Told | null, unit: string): Row {
  const told = second ? [first, second] : [first];
  const lines = told.map(([label, colour]) => ({ label, colour }));
  const say = (value: number | null | undefined) =>
    value === null || value === undefined ? "–" : `${short(value)}${unit}`;
  const look = { title, lines, say, tick: short, least: 1 };
  return {
    chart: new Chart({ ...look, across: minutes }),
    columns: told.map(
      ([, , key]) =>
        (measures) =>
          measures[key],
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

/** Thousands as k: an axis has little room. */
export function short(value: number): string {
  if (value >= 1e6) return `${digits(value / 1e6)} M`;
  return value >= 10_000 ? `${digits(value / 1000)} k` : digits(value);
}
