/** One slider and one number per adverb; both say what the goal is, however it was moved. */

import type { Page } from "../app";
import type { Verb } from "../types";
import { h } from "./dom";

type Adverb = Verb["adverbs"][number];

/** Steps of a slider from end to end, at least. */
const STEPS = 200;

export function adverbs(page: Page): HTMLElement {
  const rows = h("div", { className: "adverbs" }, h("p", { className: "quiet" }, "Loading…"));
  let show = () => {};
  page.on("verb", (verb) => {
    const made = verb.adverbs.map((adverb) => row(page, adverb));
    rows.replaceChildren(...made.map(({ element }) => element));
    show = () => {
      for (const each of made) each.show();
    };
    show();
  });
  page.store.on(["goal"], () => show());
  return rows;
}

function row(page: Page, adverb: Adverb): { element: HTMLElement; show: () => void } {
  const { name, unit, min, max, description, style } = adverb;
  const step = stepOf(max - min);
  const shared = { min: String(min), max: String(max), step: String(step) };
  const aim = (value: number, done: boolean) => page.aim({ [name]: value }, done);
  const range = h("input", {
    type: "range",
    ...shared,
    "aria-label": `${name}, ${unit}`,
    oninput: () => aim(Number(range.value), false),
    onchange: () => aim(Number(range.value), true),
  });
  const number = h("input", {
    type: "number",
    step: String(step),
    "aria-label": `${name}, ${unit}`,
    onchange: () => (Number.isFinite(number.valueAsNumber) ? aim(number.valueAsNumber, true) : show()),
  });
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const show = () => {
    const value = page.store.view.goal[name] ?? (min + max) / 2;
    range.value = String(value);
    range.style.setProperty("--done", String((Number(range.value) - min) / (max - min || 1)));
    if (document.activeElement !== number) number.value = (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits);
    number.classList.toggle("beyond", value < min || value > max);
  };
  const element = h(
    "div",
    { className: "adverb", title: `${name}: ${description || unit}` },
    h("span", { className: "name" }, name.replaceAll("_", " "), style && h("small", {}, "style")),
    range,
    number,
    h("span", { className: "unit" }, unit),
  );
  return { element, show };
}

/** A round step, of which a range has a few hundred. */
function stepOf(range: number): number {
  return range > 0 ? 10 ** Math.floor(Math.log10(range / STEPS)) : 0.001;
}
