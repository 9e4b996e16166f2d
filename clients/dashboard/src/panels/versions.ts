/** Versions of the verb, the newest first: what they are like, which one is served; roll back, compare, download. */

import { Problem } from "../api/rest";
import { textOf } from "../app";
import { h } from "../shell/dom";
import { methodName } from "../shell/header";
import type { App, Refinement, Version, Versions } from "../types";
import { Life } from "./parts/disposables";
import { ago, courseOf, figuresOf, makerText } from "./parts/labels";
import { bytes, counted, digits, errorUnit, kappa } from "./parts/units";

const LONG_REASON = 90;
const AGAIN_MS = 30_000;

export function mount(host: HTMLElement, app: App): () => void {
  const life = new Life();
  const list = new List(app, life);
  host.append(list.failure, list.element);
  return () => life.end();
}

class List {
  readonly element = h("ol", { className: "versions-list", "aria-label": "Versions" });
  readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private known: Versions | null = null;
  /** Pseudo-examples by version. */
  private pseudo = new Map<number, number>();

  constructor(
    private readonly app: App,
    private readonly life: Life,
  ) {
    const timer = setInterval(() => this.show(), AGAIN_MS); // "a minute ago" ages
    life.add(
      () => clearInterval(timer),
      app.on("verb", () => void this.load()),
      app.store.on(["verb"], () => this.clear()),
      app.store.on(["against"], () => this.show()),
    );
    void this.load();
  }

  private clear(): void {
    this.known = null;
    this.element.replaceChildren();
  }

  private fail(text: string): void {
    this.failure.textContent = text;
    this.failure.hidden = text === "";
  }

  private async load(): Promise<void> {
    const { rest, store } = this.app;
    const { verb } = store.view;
    if (!verb) return;
    const stale = () => this.life.over || verb !== store.view.verb;
    try {
      const [versions, refined] = await Promise.all([rest.versions(verb), rest.refinements({ verb })]);
      if (stale()) return;
      this.known = versions;
      this.pseudo = pseudoOf(refined);
      this.fail("");
      this.show();
    } catch (err) {
      if (stale()) return;
      this.clear();
      this.fail(err instanceof Problem && err.code === "read_only" ? `Read-only: ${err.detail}.` : textOf(err));
    }
  }

  private show(): void {
    const { known } = this;
    if (known) this.element.replaceChildren(...known.versions.map((version) => this.row(version, known.current)));
  }

  private row(version: Version, current: number | null): HTMLElement {
    const { app } = this;
    const acts = version.current ? [] : [this.serveButton(version, current), this.compareButton(version.version)];
    const href = app.rest.artifact(version.verb, version.version);
    return h(
      "li",
      { className: version.current ? "version-row current" : "version-row" },
      head(version),
      reason(version),
      figures(version, app.verb?.measure.unit ?? "m", this.pseudoIn(version)),
      h("div", { className: "acts" }, ...acts, h("a", { className: "button", href, download: "" }, "Download")),
    );
  }

  private pseudoIn({ verb, version }: Version): number {
    const served = this.app.verb?.name === verb && this.app.verb.version === version ? this.app.verb : null;
    return this.pseudo.get(version) ?? served?.pseudo_examples.length ?? 0;
  }

  private serveButton(version: Version, current: number | null): HTMLElement {
    const older = current !== null && version.version < current;
    const button = h("button", { type: "button" }, older ? "Roll back to it" : "Activate");
    button.onclick = () => {
      button.disabled = true;
      void this.activate(version, current);
    };
    return button;
  }

  private async activate({ verb, version }: Version, current: number | null): Promise<void> {
    let problem = "";
    try {
      await this.app.rest.activate(verb, version, current ?? undefined);
      await this.app.reload();
    } catch (err) {
      problem = textOf(err);
    }
    await this.load();
    if (problem) this.fail(problem);
  }

  private compareButton(version: number): HTMLElement {
    const { store } = this.app;
    const { against } = store.view;
    const on = against.kind === "version" && against.version === version;
    const title = "Show it beside the version that is served, at the same goal";
    const onclick = () => store.change({ against: on ? { kind: "nothing" } : { kind: "version", version } });
    return h("button", { type: "button", "aria-pressed": String(on), title, onclick }, on ? "Beside it" : "Compare");
  }
}

function head({ version, current, created_at }: Version): HTMLElement {
  const made = new Date(1000 * created_at);
  return h(
    "div",
    { className: "version-head" },
    h("strong", {}, `Version ${version}`),
    current && h("span", { className: "badge" }, "served"),
    h("time", { dateTime: made.toISOString(), title: made.toLocaleString() }, ago(Date.now() / 1000 - created_at)),
  );
}

function reason(version: Version): HTMLElement {
  const { why } = version;
  const who = `By ${makerText(version)}, ${bytes(version.bytes)}`;
  if (why.length <= LONG_REASON) return h("p", { className: "quiet" }, why ? `${who}: ${why}` : who);
  return h("details", { className: "quiet" }, h("summary", {}, who), why);
}

function figures(version: Version, unit: string, pseudo: number): HTMLElement | null {
  const rows = figuresOf(version);
  if (rows.length === 0) return null;
  const bends = rows.some(({ kappa: bend }) => bend !== null);
  const { text: written, factor } = errorUnit(unit, Math.max(...rows.map(({ max }) => max || 0)));
  const heads = [`error, ${written}`, "mean", "largest", ...(bends ? ["κ"] : [])];
  const cells = rows.map(({ method, mean, max, kappa: bend }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, methodName(method)),
      ...[digits(mean * factor), digits(max * factor), ...(bends ? [kappa(bend)] : [])].map((text) =>
        h("td", {}, text),
      ),
    ),
  );
  const count = pseudo === 0 ? null : h("caption", {}, counted(pseudo, "pseudo-example"));
  return h(
    "table",
    { className: "figures" },
    count,
    h("thead", {}, h("tr", {}, ...heads.map((text) => h("th", { scope: "col" }, text)))),
    h("tbody", {}, ...cells),
  );
}

/** Pseudo-examples by the version that a refinement became. */
function pseudoOf(refinements: readonly Refinement[]): Map<number, number> {
  const ended = refinements.filter(({ version_after }) => version_after !== null);
  return new Map(ended.map((refinement) => [refinement.version_after ?? 0, courseOf(refinement).pseudo]));
}
