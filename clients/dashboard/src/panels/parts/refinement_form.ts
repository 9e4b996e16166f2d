/** Form for a new refinement. */

import { choice, h, toggle } from "../../shell/dom";
import type { RefinementRequest } from "../../types";

interface Bounds {
  min: number;
  max: number;
  step: number;
  value: number;
}

export type Aim = "quality" | "error";

const AIMS = [
  ["quality", "motion"],
  ["error", "error"],
] as const;

const METHODS = [
  ["refined", "refined"],
  ["hybrid", "hybrid"],
] as const;

const ABOUT: Record<Aim, string> = {
  quality:
    "Finds goals where the motion whips, twists a joint beyond the examples, or slides on its feet, and blends the " +
    "examples better there. The default method corrected uses the result; goals are met exactly, as before.",
  error:
    "Adds pseudo-examples where the error is largest. Only the methods refined and hybrid use them; the method " +
    "corrected has no error and does not change.",
};

const MOST: Record<Aim, number> = { quality: 8, error: 300 };
const LIMIT: Record<Aim, number> = { quality: 64, error: 2000 };

/** The form; its button is disabled until `start` resolves. `setAim` selects what a refinement is for. */
export function refinementForm(start: (request: Partial<RefinementRequest>) => Promise<void>) {
  const about = h("p", { className: "quiet refine-about" });
  const aim = choice("Refine for", AIMS, () => setAim(chosen()));
  const target = field("Target error, %", { min: 0.01, max: 100, step: 0.01, value: 1 });
  target.element.title = "Stop below this largest error, relative to the diagonal of the goal range";
  const limit = field("Max. pseudo-examples", { min: 0, max: LIMIT.error, step: 1, value: MOST.error });
  const seconds = field("Time limit, s", { min: 1, max: 604_800, step: 1, value: 600 });
  const method = choice("Evaluate with", METHODS, () => {});
  const usage = toggle("Weight by usage", () => {});
  usage.element.title = "Place pseudo-examples first where clients request the verb";
  const button = h("button", { type: "submit", className: "primary" }, "Start");
  const forError = [target.element, method.element, usage.element];
  const chosen = (): Aim => (aim.select.value === "error" ? "error" : "quality");
  const setAim = (wanted: Aim) => {
    aim.select.value = wanted;
    about.textContent = ABOUT[wanted];
    limit.input.max = String(LIMIT[wanted]);
    limit.input.valueAsNumber = MOST[wanted];
    for (const element of forError) element.hidden = wanted !== "error";
    target.input.disabled = wanted !== "error"; // a hidden field would still be validated
  };
  const onsubmit = async (event: Event) => {
    event.preventDefault();
    button.disabled = true;
    const run = { max_pseudo: limit.input.valueAsNumber, budget_s: seconds.input.valueAsNumber };
    const errors: Partial<RefinementRequest> = {
      target_error: target.input.valueAsNumber / 100,
      method: method.select.value === "hybrid" ? "hybrid" : "refined",
      weighted_by_traffic: usage.box.checked,
    };
    const wanted = chosen();
    await start(wanted === "error" ? { for: wanted, ...run, ...errors } : { for: wanted, ...run });
    button.disabled = false;
  };
  const fields = [aim.element, limit.element, seconds.element, ...forError, button];
  setAim("quality");
  const element = h("div", {}, about, h("form", { className: "refine", onsubmit }, ...fields));
  return { element, setAim };
}

function field(label: string, { min, max, step, value }: Bounds) {
  const numbers = { min: String(min), max: String(max), step: String(step), value: String(value) };
  const input = h("input", { type: "number", required: true, ...numbers });
  return { element: h("label", { className: "field" }, h("span", {}, label), input), input };
}
