/** Sliders of adverbs: those that a slice fixes, and those of a draft's goal. */

import { h } from "../../shell/dom";
import type { Verb } from "../../types";
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
  return slice.fixed.map(([adverb, value]) => adverbSlider(adverb, `Slice at ${adverb.name}`, value, drag));
}

/** Slider over an adverb's range, with its value and unit. */
export function adverbSlider(
  { name, min, max, unit, description }: Verb["adverbs"][number],
  title: string,
  value: number,
  drag: (name: string, value: number) => void,
): SliderRow {
  const { text: unitText, factor } = adverbUnit(unit);
  const range = h("input", {
    type: "range",
    min: String(min),
    max: String(max),
    step: String((max - min) / STEPS || 1),
    "aria-label": `${title}, ${unitText}`,
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
}
