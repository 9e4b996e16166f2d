/** What a refinement should come to. */

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

/** The form; `start` is called with what was asked, and the form waits for it. */
export function refinementForm(start: (asked: Partial<RefinementRequest>) => Promise<void>): HTMLElement {
  const target = field("Target error, %", { min: 0.01, max: 100, step: 0.01, value: 1 });
  target.element.title = "Largest error at which to stop, as a share of the diagonal of the examples' goals";
  const most = field("Most pseudo-examples", { min: 0, max: 2000, step: 1, value: 300 });
  const seconds = field("Most seconds", { min: 1, max: 604_800, step: 1, value: 600 });
  const method = choice("Judged by", METHODS, () => {});
  const traffic = toggle("Weighted by traffic", () => {});
  traffic.element.title = "Look first where the verb is asked for";
  const button = h("button", { type: "submit", className: "primary" }, "Start");
  const onsubmit = async (event: Event) => {
    event.preventDefault();
    button.disabled = true;
    await start({
      target_error: target.input.valueAsNumber / 100,
      max_pseudo: most.input.valueAsNumber,
      budget_s: seconds.input.valueAsNumber,
      method: method.select.value === "hybrid" ? "hybrid" : "refined",
      weighted_by_traffic: traffic.box.checked,
    });
    button.disabled = false;
  };
  const fields = [target.element, most.element, seconds.element, method.element, traffic.element, button];
  return h("form", { className: "refine", onsubmit }, ...fields);
}

function field(label: string, { min, max, step, value }: Bounds) {
  const numbers = { min: String(min), max: String(max), step: String(step), value: String(value) };
  const input = h("input", { type: "number", required: true, ...numbers });
  return { element: h("label", { className: "field" }, h("span", {}, label), input), input };
}
