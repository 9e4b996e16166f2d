/** The top of the page: which verb, by which method, beside what; how the connection is. */

import type { Page } from "../app";
import type { Against, Stats, View } from "../types";
import { choice, h, icon, offer } from "./dom";

const THEMES = { auto: "As the system", light: "Light", dark: "Dark" } as const;
const METHOD_WORDS: Record<string, string> = { rbf: "RBF", knn: "KNN", perdof: "per DOF" };

export function header(page: Page, help: () => void): HTMLElement {
  return h(
    "header",
    { className: "header" },
    h("h1", {}, "Adverb"),
    h("div", { className: "pickers" }, verbPicker(page), methodPicker(page), againstPicker(page)),
    h("div", { className: "grow" }),
    link(page),
    themePicker(page),
    h("button", { type: "button", className: "plain", "aria-label": "Keys", title: "Keys (?)", onclick: help }, "?"),
  );
}

export function methodName(method: string): string {
  return METHOD_WORDS[method] ?? method;
}

function verbPicker(page: Page): HTMLElement {
  const { element, select } = choice("Verb", [], (verb) => page.choose(verb));
  const version = h("span", { className: "version", title: "Version that is served" });
  const show = () => {
    select.value = page.store.view.verb;
    version.textContent = page.verb ? `v${page.verb.version}` : "";
  };
  page.on("verbs", (verbs) => {
    offer(
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
  element.title = "The verb's own method stands first";
  const show = () => {
    const { verb } = page;
    const own = verb ? methodName(verb.default_method) : "";
    const others = verb?.methods.filter((method) => method !== verb.default_method) ?? [];
    offer(select, [["", own], ...others.map((method) => [method, methodName(method)] as const)]);
    const { method } = page.store.view;
    select.value = method === verb?.default_method ? "" : method;
  };
  page.on("verb", show);
  page.store.on(["method"], show);
  return element;
}

function againstPicker(page: Page): HTMLElement {
  const { element, select } = choice("Compare with", [["", "nothing"]], (value) => {
    page.store.change({ against: read(value) });
  });
  let versions: number[] = [];
  const show = () => {
    const { verb, store } = page;
    const { against } = store.view;
    const kept = new Set([...versions, ...(against.kind === "version" ? [against.version] : [])]);
    offer(select, [
      ["", "nothing"],
      ...(verb?.methods ?? []).map((method) => [`method:${method}`, methodName(method)] as const),
      ...[...kept].map((version) => [`version:${version}`, `version ${version}`] as const),
    ]);
    select.value = written(against);
  };
  page.on("verb", async ({ name, version }) => {
    versions = [];
    show();
    const known = await page.rest.versions(name).catch(() => null); // a server without a data folder keeps none
    if (known?.verb !== page.verb?.name) return;
    versions = known?.versions.map((row) => row.version).filter((row) => row !== version) ?? [];
    show();
  });
  page.store.on(["against"], show);
  return element;
}

function written(against: Against): string {
  if (against.kind === "method") return `method:${against.method}`;
  return against.kind === "version" ? `version:${against.version}` : "";
}

function read(value: string): Against {
  const [kind, rest = ""] = value.split(/:(.*)/s);
  if (kind === "method") return { kind, method: rest };
  return kind === "version" ? { kind, version: Number(rest) } : { kind: "nothing" };
}

/** One line about the connection; the details are in the panel. */
function link(page: Page): HTMLElement {
  const words = h("span", {});
  const element = h(
    "div",
    {
      className: "link",
      "data-state": page.connection,
      title: "Messages a second, and how old 95 of 100 are on arrival",
    },
    words,
  );
  const show = (stats: Stats | null) => {
    element.dataset.state = page.connection;
    words.textContent =
      page.connection === "open"
        ? stats && stats.messages_per_s > 0
          ? `${stats.messages_per_s.toFixed(0)} messages/s · ${stats.lateness_p95_ms.toFixed(0)} ms late`
          : "connected"
        : page.connection;
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
    const text = `Colours: ${THEMES[page.store.view.theme].toLowerCase()}`;
    button.ariaLabel = button.title = text;
  };
  page.store.on(["theme"], show);
  show();
  return button;
}
