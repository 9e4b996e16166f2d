/** Form for a new refinement. */

import { choice, h, toggle } from "../../shell/dom";
import type { RefinementRequest } from "../../types";

interface Bounds {
  min: number;
  max: number;
  step: number;
  value: number;
}

const METHODS = [
  ["refined", "refined"],
  ["hybrid", "hybrid"],
] as const;

/** The form; its button is disabled until `start` resolves. */
export function refinementForm(start: (request: Partial<RefinementRequest>) => Promise<void>): HTMLElement {
  const target = field("Target error, %", { min: 0.01, max: 100, step: 0.01, value: 1 });
  target.element.title = "Stop below this largest error, relative to the diagonal of the goal range";
  const limit = field("Max. pseudo-examples", { min: 0, max: 2000, step: 1, value: 300 });
  const seconds = field("Time limit, s", { min: 1, max: 604_800, step: 1, value: 600 });
  const method = choice("Evaluate with", METHODS, () => {});
  const usage = toggle("Weight by usage", () => {});
  usage.element.title = "Place pseudo-examples first where clients request the verb";
  const button = h("button", { type: "submit", className: "primary" }, "Start");
  const onsubmit = async (event: Event) => {
    event.preventDefault();
    button.disabled = true;
    await start({
      target_error: target.input.valueAsNumber / 100,
      max_pseudo: limit.input.valueAsNumber,
      budget_s: seconds.input.valueAsNumber,
      method: method.select.value === "hybrid" ? "hybrid" : "refined",
      weighted_by_traffic: usage.box.checked,
    });
    button.disabled = false;
  };
  const fields = [target.element, limit.element, seconds.element, method.element, usage.element, button];
  return h("form", { className: "refine", onsubmit }, ...fields);
}

function field(label: string, { min, max, step, value }: Bounds) {
  const numbers = { min: String(min), max: String(max), step: String(step), value: String(value) };
  const input = h("input", { type: "number", required: true, ...numbers });
  return { element: h("label", { className: "field" }, h("span", {}, label), input), input };
}
