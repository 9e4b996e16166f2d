/** Small line chart in the page's colours, with current values in its caption. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { h } from "../../shell/dom";

export interface Line {
  label: string;
  /** CSS colour variable, such as `--accent`. */
  colour: string;
  dash?: number[];
}

export interface ChartLook {
  title: string;
  lines: readonly Line[];
  /** Format a value with its unit, for the caption. */
  format(value: number | null | undefined): string;
  /** Format a value for the axis. */
  tick(value: number): string;
  /** Whether the vertical axis is logarithmic. */
  log?: boolean;
  /** Smallest upper limit of the vertical axis. */
  least?: number;
  across?: Required<Pick<uPlot.Axis, "splits" | "values">> & { range: uPlot.Range.Function };
}

export type Column = readonly (number | null)[];

const HEIGHT = 96;
const AXIS_WIDTH = 44;
const FONT = "11px system-ui, sans-serif";

export class Chart {
  readonly element: HTMLElement;
  private readonly host = h("div", { className: "chart-host" });
  private readonly figures: HTMLElement[];
  private readonly plot: uPlot;
  private readonly sizes: ResizeObserver;
  private readonly themes: MutationObserver;
  private columns: readonly Column[] = [];

  constructor(private readonly look: ChartLook) {
    this.figures = look.lines.map(() => h("output", { "aria-live": "off" }));
    const keys = look.lines.map(({ label, colour }, k) =>
      h(
        "span",
        { className: "key" },
        h("i", { style: `background: var(${colour})` }),
        `${label} `,
        this.figures[k] ?? null,
      ),
    );
    this.element = h(
      "figure",
      { className: "chart" },
      h(
        "figcaption",
        {},
        h("span", { className: "chart-title" }, look.title),
        h("span", { className: "chart-keys" }, ...keys),
      ),
      this.host,
    );
    this.plot = new uPlot(
      optionsOf(look, (at) => this.write(at)),
      [[]],
      this.host,
    );
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(this.host);
    this.themes = new MutationObserver(() => this.plot.redraw());
    this.themes.observe(document.documentElement, { attributeFilter: ["data-theme"] });
  }

  /** Set the x values and one column per line. */
  show(across: readonly number[], columns: readonly Column[]): void {
    this.columns = columns;
    this.plot.setData([across, ...columns] as uPlot.AlignedData);
    this.write(this.plot.cursor.idx);
  }

  dispose(): void {
    this.sizes.disconnect();
    this.themes.disconnect();
    this.plot.destroy();
    this.element.remove();
  }

  private fit(): void {
    if (this.host.clientWidth > 0) this.plot.setSize({ width: this.host.clientWidth, height: HEIGHT });
  }

  /** Show the values at the cursor, or the newest values. */
  private write(at: number | null | undefined): void {
    this.columns.forEach((column, k) => {
      const figure = this.figures[k];
      if (figure) figure.textContent = this.look.format(column[at ?? column.length - 1]);
    });
  }
}

function optionsOf(look: ChartLook, pointed: (at: number | null | undefined) => void): uPlot.Options {
  const grid = { stroke: () => colourOf("--line"), width: 1 };
  const quiet = { stroke: () => colourOf("--quiet"), font: FONT, grid, ticks: { show: false } };
  const { least = 0, across } = look;
  const upwards: uPlot.Scale = look.log ? { distr: 3 } : { range: (_, __, high) => [0, Math.max(high * 1.08, least)] };
  return {
    width: 280,
    height: HEIGHT,
    padding: [6, 14, 0, 0],
    legend: { show: false },
    cursor: { y: false, drag: { setScale: false, x: false, y: false }, points: { size: 5 } },
    scales: { x: { time: false, ...(across && { range: across.range }) }, y: upwards },
    axes: [
      {
        ...quiet,
        size: 20,
        gap: 2,
        ...(across && { splits: across.splits, values: across.values }),
      },
      {
        ...quiet,
        size: AXIS_WIDTH,
        gap: 4,
        space: 24,
        ...(look.log && { splits: decades }),
        values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : look.tick(tick))),
      },
    ],
    series: [
      {},
      ...look.lines.map(({ colour, dash }) => ({
        stroke: () => colourOf(colour),
        width: 1.5,
        points: { show: false },
        ...(dash && { dash }),
      })),
    ],
    hooks: { setCursor: [(plot) => pointed(plot.cursor.idx)] },
  };
}

function decades(_: uPlot, __: number, low: number, high: number): number[] {
  const first = Math.ceil(Math.log10(low) - 1e-9);
  const last = Math.floor(Math.log10(high) + 1e-9);
  return Array.from({ length: last - first + 1 }, (___, k) => 10 ** (first + k));
}

function colourOf(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
