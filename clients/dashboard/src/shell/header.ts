/** Header: verb, method, comparison and connection state. */

import type { Page } from "../app";
import type { Comparison, Connection, Stats, View } from "../types";
import { choice, h, icon, setOptions } from "./dom";

const THEMES = { auto: "System", light: "Light", dark: "Dark" } as const;
const METHOD_LABELS: Record<string, string> = { rbf: "RBF", knn: "KNN", perdof: "per DOF" };

export const CONNECTION_LABELS: Record<Connection, string> = {
  connecting: "connecting…",
  open: "connected",
  lost: "reconnecting…",
  closed: "closed",
};

export function header(page: Page, help: () => void): HTMLElement {
  return h(
    "header",
    { className: "header" },
    h("h1", {}, "Adverb"),
    driveButton(page),
    h("div", { className: "pickers" }, verbPicker(page), methodPicker(page), comparisonPicker(page)),
    h("div", { className: "grow" }),
    connectionLine(page),
    themePicker(page),
    h(
      "button",
      {
        type: "button",
        className: "plain",
        "aria-label": "Keyboard shortcuts",
        title: "Keyboard shortcuts (?)",
        onclick: help,
      },
      "?",
    ),
  );
}

/** Toggle of drive mode; hidden without a verb that can be driven. */
function driveButton(page: Page): HTMLElement {
  const button = h("button", {
    type: "button",
    className: "drive",
    hidden: true,
    title: "Steer the character with keys, a gamepad or touch",
    onclick: () => {
      if (page.store.view.drive) page.stopDriving();
      else page.startDriving();
      document.querySelector<HTMLElement>(".scene")?.focus(); // so that the space bar does not press the button
    },
  });
  const show = () => {
    button.hidden = !page.canDrive;
    button.ariaPressed = String(page.store.view.drive);
    button.textContent = page.store.view.drive ? "Stop driving" : "Drive";
  };
  page.on("verbs", show);
  page.store.on(["drive"], show);
  return button;
}

export function methodLabel(method: string): string {
  return METHOD_LABELS[method] ?? method;
}

function verbPicker(page: Page): HTMLElement {
  const { element, select } = choice("Verb", [], (verb) => page.selectVerb(verb));
  const version = h("span", { className: "version", title: "Current version" });
  const show = () => {
    select.value = page.store.view.verb;
    version.textContent = page.verb ? `v${page.verb.version}` : "";
  };
  page.on("verbs", (verbs) => {
    setOptions(
      select,
      verbs.map(({ name }) => [name, name]),
    );
    select.disabled = verbs.length === 0;
    show();
  });
  page.on("verb", show);
  page.store.on(["verb"], show);
  return h("div", { className: "verb-picker" }, element, version);
}

function methodPicker(page: Page): HTMLElement {
  const { element, select } = choice("Method", [], (method) => page.store.change({ method }));
  element.title = "The verb's default method is listed first";
  const show = () => {
    const { verb } = page;
    const byDefault = verb ? methodLabel(verb.default_method) : "";
    const others = verb?.methods.filter((method) => method !== verb.default_method) ?? [];
    setOptions(select, [["", byDefault], ...others.map((method) => [method, methodLabel(method)] as const)]);
    const { method } = page.store.view;
    select.value = method === verb?.default_method ? "" : method;
  };
  page.on("verb", show);
  page.store.on(["method"], show);
  return element;
}

function comparisonPicker(page: Page): HTMLElement {
  const { element, select } = choice("Compare with", [["", "none"]], (value) => {
    page.store.change({ compare: readComparison(value) });
  });
  let versions: number[] = [];
  const show = () => {
    const { verb, store } = page;
    const { compare } = store.view;
    const kept = new Set([...versions, ...(compare.kind === "version" ? [compare.version] : [])]);
    setOptions(select, [
      ["", "none"],
      ...(verb?.methods ?? []).map((method) => [`method:${method}`, methodLabel(method)] as const),
      ...[...kept].map((version) => [`version:${version}`, `version ${version}`] as const),
    ]);
    select.value = writeComparison(compare);
  };
  page.on("verb", async ({ name, version }) => {
    versions = [];
    show();
    const known = await page.rest.versions(name).catch(() => null); // a server without a data folder has no versions
    if (known?.verb !== page.verb?.name) return;
    versions = known?.versions.map((row) => row.version).filter((row) => row !== version) ?? [];
    show();
  });
  page.store.on(["compare"], show);
  return element;
}

function writeComparison(compare: Comparison): string {
  if (compare.kind === "method") return `method:${compare.method}`;
  return compare.kind === "version" ? `version:${compare.version}` : "";
}

function readComparison(value: string): Comparison {
  const [kind, rest = ""] = value.split(/:(.*)/s);
  if (kind === "method") return { kind, method: rest };
  return kind === "version" ? { kind, version: Number(rest) } : { kind: "none" };
}

/** Connection summary; details are on the Service tab. */
function connectionLine(page: Page): HTMLElement {
  const text = h("span", {});
  const element = h(
    "div",
    {
      className: "link",
      "data-state": page.connection,
      title: "Pose messages per second, and 95th percentile of their age on arrival",
    },
    text,
  );
  const show = (stats: Stats | null) => {
    element.dataset.state = page.connection;
    text.textContent =
      page.connection === "open"
        ? stats && stats.messagesPerS > 0
          ? `${stats.messagesPerS.toFixed(0)} messages/s · ${stats.latenessP95Ms.toFixed(0)} ms p95`
          : CONNECTION_LABELS.open
        : CONNECTION_LABELS[page.connection];
  };
  page.on("stats", show);
  page.on("connection", () => show(page.stats));
  return element;
}

function themePicker(page: Page): HTMLElement {
  const next: Record<View["theme"], View["theme"]> = { auto: "light", light: "dark", dark: "auto" };
  const button = h("button", {
    type: "button",
    className: "plain",
    onclick: () => page.store.change({ theme: next[page.store.view.theme] }),
  });
  button.append(icon("M8 2.5a5.5 5.5 0 1 0 0 11zM8 2.5a5.5 5.5 0 0 1 0 11"));
  const show = () => {
    const text = `Theme: ${THEMES[page.store.view.theme].toLowerCase()}`;
    button.ariaLabel = button.title = text;
  };
  page.store.on(["theme"], show);
  show();
  return button;
}
