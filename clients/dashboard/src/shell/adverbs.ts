/** One slider and one number input per adverb. Angles are shown in degrees. */

import type { Page } from "../app";
import type { Verb } from "../types";
import { adverbUnit } from "../units";
import { h } from "./dom";

type Adverb = Verb["adverbs"][number];

/** Minimum number of steps of a slider. */
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
  const { name, description, style } = adverb;
  const { text: unit, factor } = adverbUnit(adverb.unit);
  const [min, max] = [adverb.min * factor, adverb.max * factor];
  const step = stepOf(max - min);
  const label = { "aria-label": `${name}, ${unit}`, step: String(step) };
  const setGoal = (value: number, done: boolean) => page.setGoal({ [name]: value / factor }, done);
  const slide = (done: boolean) => {
    const rounded = Math.round(Number(range.value) / step) * step;
    setGoal(Math.min(Math.max(rounded, min), max), done);
  };
  const range = h("input", {
    type: "range",
    min: String(min),
    max: String(max),
    ...label,
    oninput: () => slide(false),
    onchange: () => slide(true),
  });
  const number = h("input", {
    type: "number",
    ...label,
    onchange: () => (Number.isFinite(number.valueAsNumber) ? setGoal(number.valueAsNumber, true) : show()),
  });
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const show = () => {
    const value = (page.store.view.goal[name] ?? (adverb.min + adverb.max) / 2) * factor;
    range.value = String(value);
    range.style.setProperty("--done", String((Number(range.value) - min) / (max - min || 1)));
    if (document.activeElement !== number) number.value = (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits);
    number.classList.toggle("out-of-range", value < min - step / 2 || value > max + step / 2);
  };
  const element = h(
    "div",
    { className: "adverb", title: `${name}, ${adverb.unit}${description && `: ${description}`}` },
    h("span", { className: "name" }, name.replaceAll("_", " "), style && h("small", {}, "style")),
    range,
    number,
    h("span", { className: "unit" }, unit),
  );
  return { element, show };
}

/** Step of a range: a power of ten with a few hundred steps. */
function stepOf(range: number): number {
  return range > 0 ? 10 ** Math.floor(Math.log10(range / STEPS)) : 0.001;
}
