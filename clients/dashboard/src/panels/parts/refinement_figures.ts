/** Figures of a refinement for quality, before and after, and its worst goals, which can be played. */

import { h } from "../../shell/dom";
import type { App, Refinement } from "../../types";
import { adverbUnit, digits } from "../../units";

type Numbers = Record<string, number | string | null>;

interface WorstGoal {
  adverbs: Record<string, number>;
  before: Numbers;
  after: Numbers;
}

/** Comparison of a refinement for quality at held-out goals. */
export interface QualityFigures {
  for: "quality";
  now: Numbers;
  new: Numbers;
  goals: number;
  better_ratio: number;
  worse_ratio: number;
  worst: readonly WorstGoal[];
}

/** Field, name with unit, and displayed units per unit. */
const ROWS: readonly (readonly [key: string, name: string, factor: number])[] = [
  ["peak_p95_m_s2", "Peak acceleration, p95, m/s²", 1],
  ["peak_max_m_s2", "Peak acceleration, largest, m/s²", 1],
  ["over_ratio", "Harder than any example, %", 100],
  ["range_p95_rad", "Joint beyond the examples, p95, °", 180 / Math.PI],
  ["slide_p90_m", "Foot slide before planting, p90, mm", 1000],
  ["cost_mean", "Mean cost", 1],
];

/** Figures of an evaluated refinement for quality; null for others. */
export function qualityFigures({ progress }: Refinement): QualityFigures | null {
  const figures = (progress as { figures?: Partial<QualityFigures> }).figures;
  return figures?.for === "quality" && figures.now && figures.new ? (figures as QualityFigures) : null;
}

/** Name, and values before and after, of each figure that the verb has. */
export function figureRows({ now, new: fresh }: QualityFigures): [string, string, string][] {
  return ROWS.flatMap(([key, name, factor]) => {
    const [before, after] = [now[key], fresh[key]];
    if (typeof before !== "number" || typeof after !== "number") return [];
    return [[name, digits(factor * before), digits(factor * after)]];
  });
}

/** The version that is compared with the current one: of the two of a refinement the one that is not served. */
export function otherVersion({ version_before, version_after }: Refinement, current: number | undefined) {
  return current === version_after ? version_before : version_after;
}

export function figuresElement(app: App, refinement: Refinement, figures: QualityFigures): HTMLElement {
  const heads = [`At ${figures.goals} unseen goals`, "before", "after"].map((text) => h("th", { scope: "col" }, text));
  const rows = figureRows(figures).map(([name, before, after]) =>
    h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, before), h("td", {}, after)),
  );
  const table = h(
    "table",
    { className: "quality-table" },
    h("thead", {}, h("tr", {}, ...heads)),
    h("tbody", {}, ...rows),
  );
  const shares = `${percentOf(figures.better_ratio)} of the goals are better by a tenth or more, ${percentOf(figures.worse_ratio)} worse.`;
  const beside = h(
    "p",
    { className: "quiet" },
    "Play shows the served version; in orange beside it the one before or after.",
  );
  return h(
    "div",
    {},
    table,
    h("p", { className: "quiet" }, shares),
    worstElement(app, refinement, figures.worst),
    refinement.version_after !== null && beside,
  );
}

function percentOf(share: number): string {
  return `${Math.round(100 * share)} %`;
}

function worstElement(app: App, refinement: Refinement, worst: readonly WorstGoal[]): HTMLElement {
  const heads = ["Worst goals: peak, m/s²", "before", "after", ""].map((text) => h("th", { scope: "col" }, text));
  const rows = worst.map((goal) => {
    const peaks = [goal.before.peak_m_s2, goal.after.peak_m_s2].map((value) =>
      h("td", {}, digits(Number(value), 0.05)),
    );
    const name = goalText(app, goal.adverbs);
    const play = h("button", { type: "button", onclick: () => playGoal(app, refinement, goal.adverbs) }, "Play");
    play.ariaLabel = `Play ${name}`;
    play.title = "Play the motion at this goal, with the other version of this refinement beside it";
    return h("tr", {}, h("th", { scope: "row" }, name), ...peaks, h("td", {}, play));
  });
  return h(
    "table",
    { className: "quality-table worst-goals" },
    h("thead", {}, h("tr", {}, ...heads)),
    h("tbody", {}, ...rows),
  );
}

/** Adverbs in the order and display units of the verb. */
function goalText(app: App, adverbs: Readonly<Record<string, number>>): string {
  const known = app.verb?.adverbs ?? Object.keys(adverbs).map((name) => ({ name, unit: "" }));
  return known
    .map(({ name, unit }) => `${name} ${digits(adverbUnit(unit).factor * (adverbs[name] ?? Number.NaN))}`)
    .join(", ");
}

/** Play the motion at a goal from its start; the version before or after is shown beside the current one. */
export function playGoal(app: App, refinement: Refinement, goal: Readonly<Record<string, number>>): void {
  const other = otherVersion(refinement, app.verb?.version);
  const compare = other === null ? ({ kind: "none" } as const) : ({ kind: "version", version: other } as const);
  app.store.change({ goal, compare, method: "", phase: 0, playing: true, loop: true });
}
