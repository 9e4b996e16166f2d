/** Sliders for the adverbs that a slice holds: they move the slice. */

import { h } from "../../shell/dom";
import type { Slice } from "./slice";
import { digits } from "./units";

const STEPS = 200;

/** One row per held adverb; a row follows the slice when it hears the event `slice`. */
export interface HeldRow {
  element: HTMLElement;
  show(at: number): void;
}

/** One row per held adverb. */
export function heldRows(slice: Slice, drag: (name: string, value: number) => void): HeldRow[] {
  return slice.held.map(([{ name, min, max, unit, description }, value]) => {
    const range = h("input", {
      type: "range",
      min: String(min),
      max: String(max),
      step: String((max - min) / STEPS || 1),
      "aria-label": `Slice at ${name}, ${unit}`,
      oninput: () => drag(name, Number(Number(range.value).toFixed(4))),
    });
    const number = h("output", { "aria-live": "off" });
    const show = (at: number) => {
      range.value = String(at);
      range.style.setProperty("--done", String((at - min) / (max - min || 1)));
      range.ariaValueText = `${digits(at)} ${unit}`;
      number.textContent = digits(at);
    };
    show(value);
    const label = h("span", { className: "name" }, name);
    const after = h("span", { className: "unit" }, unit);
    return { element: h("div", { className: "adverb", title: description }, label, range, number, after), show };
  });
}
