/** Side panel with tabs; all but the first are loaded on demand. */

import type { Page } from "../app";
import type { App, Panel } from "../types";
import { h } from "./dom";

type Mount = (host: HTMLElement, app: App) => () => void;

const TABS: readonly (readonly [Panel, string])[] = [
  ["verb", "Verb"],
  ["quality", "Quality"],
  ["versions", "Versions"],
  ["service", "Service"],
  ["upload", "Upload"],
];
const PARTS = import.meta.glob<{ mount: Mount }>("../panels/{quality,versions,service,upload}.ts");

export function panel(page: Page, first: HTMLElement): HTMLElement {
  const body = h("div", { className: "panel-body", role: "tabpanel", id: "panel", tabIndex: -1 });
  const tabs = TABS.filter(([name]) => name === "verb" || PARTS[path(name)]);
  const buttons = new Map(tabs.map(([name, label]) => [name, tabButton(page, name, label)]));
  const list = h("div", { role: "tablist", className: "tabs", "aria-label": "Panel" }, ...buttons.values());
  list.onkeydown = (event) => step(page, [...buttons.keys()], buttons, event);
  let unmount = () => {};
  let shown: Panel | null = null;
  const show = async () => {
    const name = buttons.has(page.store.view.panel) ? page.store.view.panel : "verb";
    if (name === shown) return;
    shown = name;
    unmount();
    unmount = () => {};
    for (const [each, button] of buttons) {
      button.ariaSelected = String(each === name);
      button.tabIndex = each === name ? 0 : -1;
    }
    body.setAttribute("aria-labelledby", `tab-${name}`);
    body.replaceChildren(...(name === "verb" ? [first] : []));
    body.scrollTop = 0;
    const part = PARTS[path(name)];
    if (!part) return;
    const host = h("div", { className: `part ${name}` });
    const { mount } = await part();
    if (shown !== name) return;
    body.replaceChildren(host);
    unmount = mount(host, page);
  };
  page.store.on(["panel"], () => void show());
  void show();
  return h("aside", { className: "panel", "aria-label": "Panel" }, handle(), list, body);
}

function path(name: Panel): string {
  return `../panels/${name}.ts`;
}

function tabButton(page: Page, name: Panel, label: string): HTMLButtonElement {
  return h(
    "button",
    {
      type: "button",
      role: "tab",
      id: `tab-${name}`,
      "aria-controls": "panel",
      onclick: () => {
        page.store.change({ panel: name }, true);
        sheet(true);
      },
    },
    label,
  );
}

/** Arrow keys move between tabs. */
function step(
  page: Page,
  names: readonly Panel[],
  buttons: ReadonlyMap<Panel, HTMLElement>,
  event: KeyboardEvent,
): void {
  const by = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
  const at = names.indexOf(page.store.view.panel);
  const next = names[(at + by + names.length) % names.length];
  if (by === 0 || next === undefined) return;
  event.preventDefault();
  event.stopPropagation();
  page.store.change({ panel: next }, true);
  buttons.get(next)?.focus();
}

/** On a phone the panel is a bottom sheet. */
function handle(): HTMLElement {
  return h("button", {
    type: "button",
    className: "handle",
    "aria-label": "Panel",
    "aria-expanded": "false",
    onclick: () => sheet(document.documentElement.dataset.sheet !== "open"),
  });
}

function sheet(open: boolean): void {
  document.documentElement.dataset.sheet = open ? "open" : "closed";
  document.querySelector(".handle")?.setAttribute("aria-expanded", String(open));
}
