/** Sliders of the adverbs that a slice fixes. */

import { h } from "../../shell/dom";
import { adverbUnit, digits } from "../../units";
import type { Slice } from "./slice";

const STEPS = 200;

/** A slider and its setter. */
export interface SliderRow {
  element: HTMLElement;
  show(at: number): void;
}

/** One slider per fixed adverb. */
export function sliceSliders(slice: Slice, drag: (name: string, value: number) => void): SliderRow[] {
  return slice.fixed.map(([{ name, min, max, unit, description }, value]) => {
    const { text: unitText, factor } = adverbUnit(unit);
    const range = h("input", {
      type: "range",
      min: String(min),
      max: String(max),
      step: String((max - min) / STEPS || 1),
      "aria-label": `Slice at ${name}, ${unitText}`,
      oninput: () => drag(name, Number(Number(range.value).toFixed(4))),
    });
    const number = h("output", { "aria-live": "off" });
    const show = (at: number) => {
      range.value = String(at);
      range.style.setProperty("--done", String((at - min) / (max - min || 1)));
      range.ariaValueText = `${digits(at * factor)} ${unitText}`;
      number.textContent = digits(at * factor);
    };
    show(value);
    const label = h("span", { className: "name" }, name);
    const after = h("span", { className: "unit" }, unitText);
    return { element: h("div", { className: "adverb", title: description }, label, range, number, after), show };
  });
}
