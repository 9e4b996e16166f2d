/** Readout: live distance to the goal, predicted error at the goal's keytime, support by the examples, comparison and phase. */

import type { Page } from "../app";
import { LEVELS } from "../scene/detail_control";
import type { Drawn, Shown, Verb } from "../types";
import { errorText, shareText, slideText } from "../units";
import { effectorPhase } from "../verb";
import { h } from "./dom";
import { goalSupport } from "./goal_support";
import { methodLabel } from "./header";

/** Update interval of the readout. */
const EVERY_MS = 100;
/** Largest error that counts as reached, m or m/s. */
const REACHED = 0.001;
/** Phase tolerance of the goal's keytime. */
const AT_KEYTIME = 0.012;

const SUPPORT =
  "How well the examples support this goal: 100 % at one, 50 % where it is as uncertain as a left-out example";

const SLIDE = "Largest horizontal movement of a foot that stands, since it landed";

const DETAIL = "Lowered before the frame rate falls below 45 per second, and raised again when there is time";

/** State of the goal, as an attribute for the style and as a text. */
export interface GoalState {
  state: "none" | "clamped" | "reached" | "missed";
  text: string;
}

/**
 * @param distance live distance between effector and goal, m; null if the verb's goal is not a position
 * @param drawn last drawn frame
 */
export function readout(page: Page, distance: () => number | null, drawn: () => Drawn | null): HTMLElement {
  const value = h("output", { className: "error", "aria-live": "off" }, "–");
  const caption = h("span", { className: "caption" }, "from the goal");
  const state = h("div", { className: "state" });
  const comparison = h("div", { className: "comparison", hidden: true });
  const facts = h("dl", { className: "facts" });
  const about = { className: "readout", "aria-label": "Goal error", hidden: true };
  const element = h("section", about, h("div", { className: "figure" }, value, caption), state, comparison, facts);
  const support = goalSupport(page);
  let dueMs = 0;
  page.on("frame", (shown) => {
    const { verb } = page;
    if (!verb || performance.now() < dueMs) return;
    dueMs = performance.now() + EVERY_MS;
    element.hidden = false;
    const live = distance();
    value.textContent = errorText(live ?? shown.error, live === null ? verb.measure.unit : "m");
    caption.textContent = live === null ? "predicted error" : "from the goal now";
    const goal = goalState(verb, shown);
    state.dataset.state = goal.state;
    state.textContent = goal.text;
    const other = page.shown.comparison;
    comparison.hidden = other === null;
    if (other) comparison.textContent = comparisonText(verb, figureLabel(page, other), other.error);
    facts.replaceChildren(...rows(page, verb, shown, support(), drawn()));
  });
  page.on("verb", () => {
    value.textContent = "–";
    state.textContent = "";
    comparison.hidden = true;
    dueMs = 0;
  });
  return element;
}

/** State of the goal: predicted before its keytime, measured at it, past after it. */
export function goalState(verb: Verb, { error, clamped, phase }: Shown): GoalState {
  if (Number.isNaN(error)) return { state: "none", text: "No measured goal" };
  if (clamped) return { state: "clamped", text: "Goal out of reach; moved to the nearest reachable point" };
  const state = error < REACHED ? "reached" : "missed";
  const keytimePhase = effectorPhase(verb);
  if (keytimePhase === null)
    return { state, text: `The whole motion ${state === "reached" ? "meets" : "misses"} its goal` };
  if (Math.abs(phase - keytimePhase) < AT_KEYTIME)
    return { state, text: state === "reached" ? "Goal reached" : "Goal missed" };
  const verbs = phase < keytimePhase ? ["Will reach", "Will miss"] : ["Reached", "Missed"];
  return { state, text: `${verbs[state === "reached" ? 0 : 1]} the goal at ${verb.measure.keytime}` };
}

/** "RBF (comparison): 226 mm off". */
export function comparisonText({ measure }: Verb, label: string, error: number): string {
  return `${label} (comparison): ${Number.isNaN(error) ? "no measured goal" : `${errorText(error, measure.unit)} off`}`;
}

function figureLabel(page: Page, shown: Shown): string {
  return page.store.view.compare.kind === "version" ? `Version ${shown.version}` : methodLabel(shown.method);
}

function rows(page: Page, { measure }: Verb, shown: Shown, support: number | null, drawn: Drawn | null): HTMLElement[] {
  const slide = drawn?.slide ?? null;
  const detail = drawn?.detail ? `lowered by ${drawn.detail} of ${LEVELS.sparse}` : "full";
  const { version, method, phase, count, error } = shown;
  return [
    ...(measure.keytime === null ? [] : [[`Error at ${measure.keytime}`, errorText(error, measure.unit)]]),
    ["Support", shareText(support), SUPPORT],
    ...(slide === null ? [] : [["Foot slide", slideText(slide), SLIDE]]),
    ["Phase", phase.toFixed(3)],
    ["Method", methodLabel(method)],
    ["Version", String(version)],
    ...(page.store.view.crowd > 1
      ? [
          ["Characters", String(count)],
          ["Detail", detail, DETAIL],
        ]
      : []),
  ].flatMap(([name, value, title]) => {
    const about = title === undefined ? {} : { title };
    return [h("dt", about, name ?? ""), h("dd", about, value ?? "")];
  });
}
