/** What is reached, in numbers: how far from what was asked, by what, and where in the motion. */

import type { Page } from "../app";
import type { Shown } from "../types";
import { errorText } from "../verb";
import { h } from "./dom";
import { methodName } from "./header";

/** Numbers for people change no faster than this. */
const EVERY_MS = 100;
/** m or m/s. */
const REACHED = 0.001;

export function readout(page: Page): HTMLElement {
  const error = h("output", { className: "error", "aria-live": "off" }, "–");
  const state = h("div", { className: "state" });
  const other = h("div", { className: "other", hidden: true });
  const facts = h("dl", { className: "facts" });
  const head = h("div", { className: "figure" }, error, h("span", { className: "caption" }, "from the goal"));
  const about = { className: "readout", "aria-label": "What is reached", hidden: true };
  const element = h("section", about, head, state, other, facts);
  let due = 0;
  const show = (shown: Shown) => {
    if (performance.now() < due) return;
    due = performance.now() + EVERY_MS;
    const { verb } = page;
    if (!verb) return;
    element.hidden = false;
    error.textContent = errorText(verb, shown.error);
    const [word, text] = stateOf(shown);
    state.dataset.state = word;
    state.textContent = text;
    const beside = page.shown.other;
    other.hidden = beside === null;
    if (beside) other.textContent = `beside it, ${nameOf(page, beside)}: ${errorText(verb, beside.error)}`;
    facts.replaceChildren(...rows(page, shown));
  };
  page.on("frame", show);
  page.on("verb", () => {
    error.textContent = "–";
    state.textContent = "";
    other.hidden = true;
    due = 0;
  });
  return element;
}

function stateOf({ error, clamped }: Shown): readonly [string, string] {
  if (Number.isNaN(error)) return ["none", "nothing is measured on this verb"];
  if (clamped) return ["clamped", "outside the examples: drawn back"];
  return error < REACHED ? ["reached", "reached"] : ["missed", "missed"];
}

function nameOf(page: Page, shown: Shown): string {
  return page.store.view.against.kind === "version" ? `version ${shown.version}` : methodName(shown.method);
}

function rows(page: Page, shown: Shown): HTMLElement[] {
  const { version, method, phase, count } = shown;
  return [
    ["Phase", phase.toFixed(3)],
    ["Method", methodName(method)],
    ["Version", String(version)],
    ...(page.store.view.crowd > 1 ? [["Characters", String(count)]] : []),
  ].flatMap(([name, value]) => [h("dt", {}, name ?? ""), h("dd", {}, value ?? "")]);
}
