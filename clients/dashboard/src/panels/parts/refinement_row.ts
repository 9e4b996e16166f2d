/** One refinement: progress, error curve and result. */

import { retryMs } from "adverb-client";
import { h } from "../../shell/dom";
import { methodLabel } from "../../shell/header";
import type { App, Refinement } from "../../types";
import { digits } from "../../units";
import { Chart } from "./chart";
import { ageText, detailText, percent, progressOf, running, stateText } from "./labels";
import { figuresElement, qualityFigures } from "./refinement_figures";
import { scoped } from "./scoped";

/** Poll a refinement after this long without an event. */
const POLL_AFTER_MS = 5000;

const CURVE = {
  title: "Error by pseudo-examples",
  lines: [
    { label: "largest", colour: "--accent" },
    { label: "mean", colour: "--quiet" },
    { label: "target", colour: "--good", dash: [4, 4] },
  ],
  format: (share: number | null | undefined) => (share ? percent(share) : "–"),
  tick: (share: number) => percent(share),
  log: true,
};

const COST = {
  title: "Cost of the motions by pseudo-examples",
  lines: [
    { label: "95th percentile", colour: "--accent" },
    { label: "mean", colour: "--quiet" },
  ],
  format: (cost: number | null | undefined) => (cost ? digits(cost) : "–"),
  tick: (cost: number) => digits(cost),
  log: true,
};

export class RefinementRow {
  readonly element: HTMLElement;
  refinement: Refinement;
  private readonly state = h("span", { className: "refinement-state" });
  private readonly when = h("time", { className: "quiet" });
  private readonly note = h("small", { className: "refinement-note" });
  private readonly bar = h("progress", { max: 1, "aria-label": "Refinement" });
  private readonly stop = h("button", { type: "button", onclick: () => void this.cancel() }, "Cancel");
  private readonly control: ReturnType<typeof scoped>;
  private readonly body = h("div", { className: "refinement-body" });
  private chart: Chart | null = null;
  private figures: HTMLElement | null = null;
  private unfollow = () => {};
  private timer: ReturnType<typeof setInterval> | undefined;
  private updatedMs = performance.now();
  private polling = false;

  constructor(
    private readonly app: App,
    refinement: Refinement,
    private readonly onError: (err: unknown) => void,
  ) {
    this.refinement = refinement;
    this.control = scoped(app, "refine", "title", this.stop);
    const about = h("summary", {}, this.state, this.when);
    const details = h("details", { className: "refinement-row", open: running(refinement) }, about, this.body);
    details.ontoggle = () => this.draw();
    this.element = details;
    this.body.append(h("div", { className: "refinement-run" }, this.bar, this.control.element), this.note);
    if (running(refinement)) this.follow();
    this.show(refinement);
  }

  get id(): string {
    return this.refinement.id;
  }

  show(refinement: Refinement): void {
    const ended = running(this.refinement) && !running(refinement);
    this.refinement = refinement;
    this.updatedMs = performance.now();
    this.state.textContent = stateText(refinement);
    this.element.dataset.state = refinement.state;
    this.age();
    this.when.title = new Date(1000 * refinement.created_at).toLocaleString();
    const { ratio, note } = progressOf(refinement);
    if (refinement.state === "queued") this.bar.removeAttribute("value");
    else this.bar.value = ratio;
    this.bar.parentElement?.toggleAttribute("hidden", !running(refinement));
    this.note.textContent = [detailText(refinement), requestText(refinement), note].filter(Boolean).join("\n");
    this.draw();
    if (!ended) return;
    this.unsubscribe();
    if (refinement.state === "published") void this.app.reload();
  }

  age(): void {
    this.when.textContent = ageText(Date.now() / 1000 - this.refinement.created_at);
  }

  dispose(): void {
    this.unsubscribe();
    this.control.dispose();
    this.chart?.dispose();
    this.element.remove();
  }

  /** Follow by server-sent events; poll if none arrive. */
  private follow(): void {
    this.unfollow = this.app.rest.follow(this.id, (refinement) => this.show(refinement));
    this.timer = setInterval(() => {
      if (!this.polling && performance.now() - this.updatedMs >= POLL_AFTER_MS) void this.poll();
    }, POLL_AFTER_MS);
  }

  private async poll(): Promise<void> {
    this.polling = true;
    try {
      const refinement = await this.app.rest.refinement(this.id);
      if (running(this.refinement)) this.show(refinement);
    } catch (err) {
      this.updatedMs = performance.now() + retryMs(err, 0); // a later poll retries
    }
    this.polling = false;
  }

  private unsubscribe(): void {
    this.unfollow();
    clearInterval(this.timer);
  }

  private async cancel(): Promise<void> {
    this.stop.disabled = true;
    try {
      this.show(await this.app.rest.cancel(this.id));
    } catch (err) {
      this.onError(err);
    }
    this.stop.disabled = false;
  }

  private draw(): void {
    const { curve } = progressOf(this.refinement);
    const open = this.element instanceof HTMLDetailsElement && this.element.open;
    if (!open) return;
    this.drawFigures();
    if (curve.length < 2) return;
    const quality = this.refinement.request.for === "quality";
    if (!this.chart) {
      this.chart = new Chart(quality ? COST : CURVE);
      this.body.prepend(this.chart.element);
    }
    const target = Number(this.refinement.request.target_error) || null;
    const column = (k: 1 | 2) => curve.map((row) => row[k] || null);
    this.chart.show(
      curve.map(([pseudo]) => pseudo),
      quality ? [column(2), column(1)] : [column(2), column(1), curve.map(() => target)],
    );
  }

  /** Figures before and after, once they are known. */
  private drawFigures(): void {
    const known = qualityFigures(this.refinement);
    if (!known || this.figures || running(this.refinement)) return;
    this.figures = figuresElement(this.app, this.refinement, known);
    this.body.append(this.figures);
  }
}

function requestText({ request }: Refinement): string {
  const { target_error, max_pseudo, budget_s, method, weighted_by_traffic } = request;
  if (request.for === "quality") return `For calmer motion, ${max_pseudo} pseudo-examples at most, ${budget_s} s`;
  const usage = weighted_by_traffic ? ", weighted by usage" : "";
  return `Target ${percent(Number(target_error))}, ${max_pseudo} pseudo-examples, ${budget_s} s, evaluated with ${methodLabel(String(method))}${usage}`;
}
