/** Refinements of the verb: one is asked for, those that run are followed, those that ended say how. */

import { Problem } from "../../api/rest";
import { textOf } from "../../app";
import { h } from "../../shell/dom";
import type { App, Refinement, RefinementRequest } from "../../types";
import type { Life } from "./disposables";
import { refinementForm } from "./refinement_form";
import { Course } from "./refinement_row";

const MOST = 6;
const AGE_MS = 30_000;

export class Refinements {
  readonly element: HTMLElement;
  private readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private readonly list = h("div", { className: "courses" });
  private readonly form = refinementForm((asked) => this.start(asked));
  private courses: Course[] = [];
  private verb = "";

  constructor(
    private readonly app: App,
    private readonly life: Life,
  ) {
    const parts = [h("h2", {}, "Refinement"), this.form, this.failure, this.list];
    this.element = h("section", { "aria-label": "Refinement" }, ...parts);
    const timer = setInterval(() => this.age(), AGE_MS);
    life.add(
      () => clearInterval(timer),
      app.store.on(["verb"], () => void this.load()),
      () => this.clear(),
    );
    void this.load();
  }

  private age(): void {
    for (const course of this.courses) course.age();
  }

  private clear(): void {
    for (const course of this.courses.splice(0)) course.dispose();
    this.failure.hidden = true;
    this.form.hidden = false;
  }

  private async load(): Promise<void> {
    const { verb } = this.app.store.view;
    if (verb === this.verb || !verb) return;
    this.clear();
    this.verb = verb;
    const stale = () => this.life.over || this.verb !== verb;
    try {
      const known = await this.app.rest.refinements({ verb, limit: MOST });
      if (!stale()) for (const each of known.reverse()) this.put(each);
    } catch (err) {
      if (!stale()) this.fail(err);
    }
  }

  private async start(asked: Partial<RefinementRequest>): Promise<void> {
    const { verb } = this;
    this.failure.hidden = true;
    try {
      const begun = await this.app.rest.refine(verb, asked);
      if (!this.life.over && this.verb === verb) this.put(begun);
    } catch (err) {
      this.fail(err);
    }
  }

  private put(refinement: Refinement): void {
    const known = this.courses.find(({ id }) => id === refinement.id);
    if (known) return known.show(refinement);
    const course = new Course(this.app, refinement, (err) => this.fail(err));
    this.courses.unshift(course);
    this.list.prepend(course.element);
    for (const old of this.courses.splice(MOST)) old.dispose();
  }

  private fail(err: unknown): void {
    const readOnly = err instanceof Problem && err.code === "read_only";
    this.failure.textContent = readOnly ? `Read-only: ${err.detail}.` : textOf(err);
    this.failure.hidden = false;
    this.form.hidden = readOnly;
  }
}
