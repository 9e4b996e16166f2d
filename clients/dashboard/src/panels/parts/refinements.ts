/** Refinements of the verb: start one, follow running ones, show results. */

import { AdverbError } from "adverb-client";
import { textOf } from "../../app";
import { h } from "../../shell/dom";
import type { App, Refinement, RefinementRequest } from "../../types";
import type { Disposables } from "./disposables";
import { refinementForm } from "./refinement_form";
import { RefinementRow } from "./refinement_row";
import { scoped } from "./scoped";

const MOST = 6;
const AGE_MS = 30_000;

export class Refinements {
  readonly element: HTMLElement;
  private readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private readonly list = h("div", { className: "refinement-list" });
  private readonly form = refinementForm((request) => this.start(request));
  private rows: RefinementRow[] = [];
  private verb = "";
  /** Verb for which the form has its default. */
  private aimed = "";

  constructor(
    private readonly app: App,
    private readonly disposables: Disposables,
  ) {
    const form = scoped(app, "refine", "text", this.form.element);
    const parts = [h("h2", {}, "Refinement"), form.element, this.failure, this.list];
    this.element = h("section", { "aria-label": "Refinement" }, ...parts);
    const timer = setInterval(() => this.age(), AGE_MS);
    disposables.add(
      () => clearInterval(timer),
      app.store.on(["verb"], () => void this.load()),
      app.on("verb", () => this.setAim()),
      () => this.clear(),
      form.dispose,
    );
    this.setAim();
    void this.load();
  }

  /** An exact verb has no error to refine. */
  private setAim(): void {
    const { verb } = this.app;
    if (!verb || verb.name === this.aimed) return;
    this.aimed = verb.name;
    this.form.setAim(verb.default_method === "corrected" ? "quality" : "error");
  }

  private age(): void {
    for (const row of this.rows) row.age();
  }

  private clear(): void {
    for (const row of this.rows.splice(0)) row.dispose();
    this.failure.hidden = true;
    this.form.element.hidden = false;
  }

  private async load(): Promise<void> {
    const { verb } = this.app.store.view;
    if (verb === this.verb || !verb) return;
    this.clear();
    this.verb = verb;
    const stale = () => this.disposables.disposed || this.verb !== verb;
    try {
      const known = await this.app.rest.refinements({ verb, limit: MOST });
      if (!stale()) for (const each of known.reverse()) this.put(each);
    } catch (err) {
      if (!stale()) this.fail(err);
    }
  }

  private async start(request: Partial<RefinementRequest>): Promise<void> {
    const { verb } = this;
    this.failure.hidden = true;
    try {
      const started = await this.app.rest.refine(verb, request);
      if (!this.disposables.disposed && this.verb === verb) this.put(started);
    } catch (err) {
      this.fail(err);
    }
  }

  private put(refinement: Refinement): void {
    const known = this.rows.find(({ id }) => id === refinement.id);
    if (known) return known.show(refinement);
    const row = new RefinementRow(this.app, refinement, (err) => this.fail(err));
    this.rows.unshift(row);
    this.list.prepend(row.element);
    for (const old of this.rows.splice(MOST)) old.dispose();
  }

  private fail(err: unknown): void {
    const readOnly = err instanceof AdverbError && err.code === "read_only";
    this.failure.textContent = readOnly ? `Read-only: ${err.detail}.` : textOf(err);
    this.failure.hidden = false;
    this.form.element.hidden = readOnly;
  }
}
