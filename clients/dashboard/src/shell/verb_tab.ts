/** The first tab: the verb in words, its adverbs, how many characters, and what is drawn besides. */

import type { Page } from "../app";
import { BOUNDS } from "../store";
import type { View } from "../types";
import { adverbs } from "./adverbs";
import { h, toggle } from "./dom";

type Flag = { [Key in keyof View]: View[Key] extends boolean ? Key : never }[keyof View];

export function verbTab(page: Page, resetView: () => void): HTMLElement {
  const words = h("p", { className: "description" });
  const more = moreButton(words);
  const numbers = h("p", { className: "quiet" });
  page.on("verb", (verb) => {
    words.textContent = verb.description;
    more.show();
    const { min, max } = verb.duration;
    const span = min === max ? `${min.toFixed(2)} s` : `${min.toFixed(2)}–${max.toFixed(2)} s`;
    numbers.textContent = `${verb.examples.length} examples · ${verb.skeleton.names.length} joints · ${span}`;
  });
  return h(
    "div",
    { className: "verb-tab" },
    words,
    more.button,
    numbers,
    h("h2", {}, "Adverbs"),
    adverbs(page),
    h("h2", {}, "Characters"),
    crowd(page),
    h("h2", {}, "Show"),
    h(
      "div",
      { className: "toggles" },
      flag(page, "hull", "Hull"),
      flag(page, "examples", "Examples"),
      flag(page, "pseudo", "Pseudo-examples"),
      flag(page, "follow", "Follow the figure"),
      detail(page),
    ),
    h("button", { type: "button", onclick: resetView, title: "Reset the view (r)" }, "Reset the view"),
  );
}

/** A long description shows its first lines, and the rest when asked. */
function moreButton(words: HTMLElement) {
  const button = h("button", {
    type: "button",
    className: "more",
    onclick: () => {
      const open = words.classList.toggle("whole");
      button.textContent = open ? "less" : "more";
      button.ariaExpanded = String(open);
    },
  });
  const show = () => {
    words.classList.remove("whole");
    button.textContent = "more";
    button.ariaExpanded = "false";
    button.hidden = words.scrollHeight <= words.clientHeight + 1;
  };
  new ResizeObserver(() => words.classList.contains("whole") || show()).observe(words);
  return { button, show };
}

function flag(page: Page, key: Flag, label: string): HTMLElement {
  const { element, box } = toggle(label, (on) => page.store.change({ [key]: on }));
  const show = () => {
    box.checked = page.store.view[key];
  };
  page.store.on([key], show);
  show();
  return element;
}

function detail(page: Page): HTMLElement {
  const { element, box } = toggle("Fine detail", (on) => page.store.change({ detail: on ? "high" : "low" }));
  element.title = "Shadows and fine shapes; off is quicker";
  const show = () => {
    box.checked = page.store.view.detail === "high";
  };
  page.store.on(["detail"], show);
  show();
  return element;
}

/** 1 to 1,000 on a slider that is fine where numbers are small. */
function crowd(page: Page): HTMLElement {
  const [least, most] = BOUNDS.crowd;
  const toCount = (share: number) => Math.round(least * (most / least) ** share);
  const set = (crowd: number) => page.store.change({ crowd: Math.min(Math.max(Math.round(crowd), least), most) });
  const range = h("input", {
    type: "range",
    min: "0",
    max: "1",
    step: "0.01",
    "aria-label": "Characters",
    oninput: () => set(toCount(Number(range.value))),
  });
  const number = h("input", {
    type: "number",
    min: String(least),
    max: String(most),
    "aria-label": "Characters",
    onchange: () => set(number.valueAsNumber || least),
  });
  const show = () => {
    const { crowd } = page.store.view;
    const share = Math.log(crowd / least) / Math.log(most / least);
    if (document.activeElement !== range) range.value = String(share);
    range.style.setProperty("--done", String(share));
    range.ariaValueText = `${crowd} characters`;
    number.value = String(crowd);
  };
  page.store.on(["crowd"], show);
  show();
  return h("div", { className: "adverb" }, h("span", { className: "name" }, "count"), range, number, h("span"));
}
