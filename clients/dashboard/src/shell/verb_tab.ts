/** Verb tab: description, adverbs, number of characters and display options. */

import type { Page } from "../app";
import type { OwnFigure } from "../own/own_figure";
import { ownFigurePart } from "../own/panel";
import { BOUNDS } from "../store";
import type { View } from "../types";
import { addClip } from "./add_clip";
import { adverbs } from "./adverbs";
import { h, toggle } from "./dom";
import { motionExport } from "./motion_export";

type Flag = { [Key in keyof View]: View[Key] extends boolean ? Key : never }[keyof View];

export function verbTab(page: Page, own: OwnFigure, resetView: () => void): HTMLElement {
  const description = h("p", { className: "description" });
  const more = moreButton(description);
  const numbers = h("p", { className: "quiet" });
  page.on("verb", (verb) => {
    description.textContent = verb.description;
    more.show();
    const { min, max } = verb.duration;
    const span = min === max ? `${min.toFixed(2)} s` : `${min.toFixed(2)}–${max.toFixed(2)} s`;
    numbers.textContent = `${verb.examples.length} examples · ${verb.skeleton.names.length} joints · ${span}`;
  });
  return h(
    "div",
    { className: "verb-tab" },
    description,
    more.button,
    numbers,
    h("h2", {}, "Adverbs"),
    adverbs(page),
    h("h2", {}, "Characters"),
    crowd(page),
    h("h2", {}, "Display"),
    h(
      "div",
      { className: "toggles" },
      flag(page, "hull", "Convex hull"),
      flag(page, "examples", "Examples"),
      flag(page, "pseudo", "Pseudo-examples"),
      flag(page, "follow", "Follow figure"),
      detail(page),
    ),
    h("button", { type: "button", onclick: resetView, title: "Reset view (r)" }, "Reset view"),
    h("h2", {}, "Your figure"),
    ownFigurePart(page, own),
    h("h2", {}, "This motion"),
    motionExport(page),
    h("h2", {}, "Examples"),
    addClip(page),
  );
}

/** Button that expands a long description. */
function moreButton(text: HTMLElement) {
  const button = h("button", {
    type: "button",
    className: "more",
    onclick: () => {
      const open = text.classList.toggle("expanded");
      button.textContent = open ? "Less" : "More";
      button.ariaExpanded = String(open);
    },
  });
  const show = () => {
    text.classList.remove("expanded");
    button.textContent = "More";
    button.ariaExpanded = "false";
    button.hidden = text.scrollHeight <= text.clientHeight + 1;
  };
  new ResizeObserver(() => text.classList.contains("expanded") || show()).observe(text);
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
  const { element, box } = toggle("High detail", (on) => page.store.change({ detail: on ? "high" : "low" }));
  element.title = "Shadows and smooth shapes; off is faster";
  const show = () => {
    box.checked = page.store.view.detail === "high";
  };
  page.store.on(["detail"], show);
  show();
  return element;
}

/** Logarithmic slider from 1 to 1,000. */
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
  return h("div", { className: "adverb" }, h("span", { className: "name" }, "Number"), range, number, h("span"));
}
