/** Versions tab, newest first: quality, roll back, compare, download. */

import { AdverbError } from "adverb-client";
import { textOf } from "../app";
import { h } from "../shell/dom";
import { download } from "../shell/download";
import { methodLabel } from "../shell/header";
import type { App, Refinement, Version, Versions } from "../types";
import { bytes, countText, digits, errorUnit, kappa } from "../units";
import { changesPart } from "./parts/changes";
import { Disposables } from "./parts/disposables";
import { ageText, authorText, progressOf, qualityRows } from "./parts/labels";
import { missing } from "./parts/scoped";

const LONG_REASON = 90;
const REFRESH_MS = 30_000;

export function mount(host: HTMLElement, app: App): () => void {
  const disposables = new Disposables();
  const list = new List(app, disposables);
  host.append(changesPart(app, disposables), list.failure, list.element);
  return () => disposables.dispose();
}

class List {
  readonly element = h("ol", { className: "versions-list", "aria-label": "Versions" });
  readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private loaded: Versions | null = null;
  /** Pseudo-examples by version. */
  private pseudo = new Map<number, number>();

  constructor(
    private readonly app: App,
    private readonly disposables: Disposables,
  ) {
    const timer = setInterval(() => this.show(), REFRESH_MS); // updates the ages
    disposables.add(
      () => clearInterval(timer),
      app.on("verb", () => void this.load()),
      app.store.on(["verb"], () => this.clear()),
      app.store.on(["compare"], () => this.show()),
      app.on("access", () => this.show()),
    );
    void this.load();
  }

  private clear(): void {
    this.loaded = null;
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
    const stale = () => this.disposables.disposed || verb !== store.view.verb;
    try {
      const [versions, refined] = await Promise.all([rest.versions(verb), rest.refinements({ verb })]);
      if (stale()) return;
      this.loaded = versions;
      this.pseudo = pseudoCounts(refined);
      this.fail("");
      this.show();
    } catch (err) {
      if (stale()) return;
      this.clear();
      this.fail(err instanceof AdverbError && err.code === "read_only" ? `Read-only: ${err.detail}.` : textOf(err));
    }
  }

  private show(): void {
    const { loaded } = this;
    if (loaded) this.element.replaceChildren(...loaded.versions.map((version) => this.row(version, loaded.current)));
  }

  private row(version: Version, current: number | null): HTMLElement {
    const { app } = this;
    const actions = version.current ? [] : [this.activateButton(version, current), this.compareButton(version.version)];
    return h(
      "li",
      { className: version.current ? "version-row current" : "version-row" },
      rowHead(version),
      reasonLine(version),
      qualityTable(version, app.verb?.measure.unit ?? "m", this.pseudoIn(version)),
      h("div", { className: "actions" }, ...actions, this.downloadButton(version)),
    );
  }

  private downloadButton({ verb, version }: Version): HTMLElement {
    const button = h("button", { type: "button" }, "Download");
    button.onclick = async () => {
      button.disabled = true;
      const problem = await download(this.app, this.app.rest.artifact(verb, version), `${verb}-v${version}.verb`);
      button.disabled = false;
      this.fail(problem);
    };
    return button;
  }

  private pseudoIn({ verb, version }: Version): number {
    const served = this.app.verb?.name === verb && this.app.verb.version === version ? this.app.verb : null;
    return this.pseudo.get(version) ?? served?.pseudo_examples.length ?? 0;
  }

  private activateButton(version: Version, current: number | null): HTMLElement {
    const older = current !== null && version.version < current;
    const button = h("button", { type: "button" }, `${older ? "Roll back to" : "Activate"} v${version.version}`);
    button.disabled = !this.app.access.may("author");
    if (button.disabled) button.title = missing("author");
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
    const { compare } = store.view;
    const on = compare.kind === "version" && compare.version === version;
    const title = "Show this version beside the current one, at the same goal";
    const onclick = () => store.change({ compare: on ? { kind: "none" } : { kind: "version", version } });
    return h("button", { type: "button", "aria-pressed": String(on), title, onclick }, on ? "Comparing" : "Compare");
  }
}

function rowHead({ version, current, created_at }: Version): HTMLElement {
  const made = new Date(1000 * created_at);
  return h(
    "div",
    { className: "version-head" },
    h("strong", {}, `Version ${version}`),
    current && h("span", { className: "badge" }, "current"),
    h("time", { dateTime: made.toISOString(), title: made.toLocaleString() }, ageText(Date.now() / 1000 - created_at)),
  );
}

function reasonLine(version: Version): HTMLElement {
  const { reason } = version;
  const published = `Published by ${authorText(version)}, ${bytes(version.bytes)}`;
  if (reason.length <= LONG_REASON)
    return h("p", { className: "quiet" }, reason ? `${published}: ${reason}` : published);
  return h("details", { className: "quiet" }, h("summary", {}, published), reason);
}

function qualityTable(version: Version, unit: string, pseudo: number): HTMLElement | null {
  const rows = qualityRows(version);
  if (rows.length === 0) return null;
  const hasKappa = rows.some(({ kappa: value }) => value !== null);
  const { text: unitText, factor } = errorUnit(unit, Math.max(...rows.map(({ max }) => max || 0)));
  const heads = [`Error, ${unitText}`, "mean", "largest", ...(hasKappa ? ["κ"] : [])];
  const cells = rows.map(({ method, mean, max, kappa: value }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, methodLabel(method)),
      ...[digits(mean * factor), digits(max * factor), ...(hasKappa ? [kappa(value)] : [])].map((text) =>
        h("td", {}, text),
      ),
    ),
  );
  const count = pseudo === 0 ? null : h("caption", {}, countText(pseudo, "pseudo-example"));
  return h(
    "table",
    { className: "quality-table" },
    count,
    h("thead", {}, h("tr", {}, ...heads.map((text) => h("th", { scope: "col" }, text)))),
    h("tbody", {}, ...cells),
  );
}

/** Pseudo-examples by published version. */
function pseudoCounts(refinements: readonly Refinement[]): Map<number, number> {
  const ended = refinements.filter(({ version_after }) => version_after !== null);
  return new Map(ended.map((refinement) => [refinement.version_after ?? 0, progressOf(refinement).pseudo]));
}
