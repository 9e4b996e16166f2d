/** One refinement: how far it is, how its error fell, and how it ended. */

import { h } from "../../shell/dom";
import type { App, Refinement } from "../../types";
import { Chart } from "./chart";
import { ago, courseOf, percent, running, stateText } from "./labels";

/** Where nothing was heard of a refinement for so long, it is asked for. */
const SILENCE_MS = 5000;

const CURVE = {
  title: "Error by pseudo-examples",
  lines: [
    { label: "largest", colour: "--accent" },
    { label: "mean", colour: "--quiet" },
    { label: "target", colour: "--good", dash: [4, 4] },
  ],
  say: (share: number | null | undefined) => (share ? percent(share) : "–"),
  tick: (share: number) => percent(share),
  log: true,
};

export class Course {
  readonly element: HTMLElement;
  refinement: Refinement;
  private readonly state = h("span", { className: "course-state" });
  private readonly when = h("time", { className: "quiet" });
  private readonly note = h("small", {});
  private readonly bar = h("progress", { max: 1, "aria-label": "Refinement" });
  private readonly stop = h("button", { type: "button", onclick: () => void this.cancel() }, "Cancel");
  private readonly body = h("div", { className: "course-body" });
  private chart: Chart | null = null;
  private unfollow = () => {};
  private timer: ReturnType<typeof setInterval> | undefined;
  private heardMs = performance.now();

  constructor(
    private readonly app: App,
    refinement: Refinement,
    private readonly fail: (err: unknown) => void,
  ) {
    this.refinement = refinement;
    const about = h("summary", {}, this.state, this.when);
    const details = h("details", { className: "course", open: running(refinement) }, about, this.body);
    details.ontoggle = () => this.draw();
    this.element = details;
    this.body.append(h("div", { className: "course-run" }, this.bar, this.stop), this.note);
    if (running(refinement)) this.follow();
    this.show(refinement);
  }

  get id(): string {
    return this.refinement.id;
  }

  show(refinement: Refinement): void {
    const ended = running(this.refinement) && !running(refinement);
    this.refinement = refinement;
    this.heardMs = performance.now();
    this.state.textContent = stateText(refinement);
    this.element.dataset.state = refinement.state;
    this.age();
    this.when.title = new Date(1000 * refinement.created_at).toLocaleString();
    const { ratio, note } = courseOf(refinement);
    if (refinement.state === "queued") this.bar.removeAttribute("value");
    else this.bar.value = ratio;
    this.bar.parentElement?.toggleAttribute("hidden", !running(refinement));
    this.note.textContent = [askedText(refinement), note].filter(Boolean).join("; ");
    this.draw();
    if (!ended) return;
    this.quit();
    if (refinement.state === "published") void this.app.reload();
  }

  age(): void {
    this.when.textContent = ago(Date.now() / 1000 - this.refinement.created_at);
  }

  dispose(): void {
    this.quit();
    this.chart?.dispose();
    this.element.remove();
  }

  /** By events; where they fail to come, by asking. */
  private follow(): void {
    this.unfollow = this.app.rest.follow(this.id, (refinement) => this.show(refinement));
    this.timer = setInterval(() => {
      if (performance.now() - this.heardMs < SILENCE_MS) return;
      this.app.rest.refinement(this.id).then(
        (refinement) => running(this.refinement) && this.show(refinement),
        () => {}, // asked again
      );
    }, SILENCE_MS);
  }

  private quit(): void {
    this.unfollow();
    clearInterval(this.timer);
  }

  private async cancel(): Promise<void> {
    this.stop.disabled = true;
    try {
      this.show(await this.app.rest.cancel(this.id));
    } catch (err) {
      this.fail(err);
    }
    this.stop.disabled = false;
  }

  private draw(): void {
    const { curve } = courseOf(this.refinement);
    const open = this.element instanceof HTMLDetailsElement && this.element.open;
    if (!open || curve.length < 2) return;
    if (!this.chart) {
      this.chart = new Chart(CURVE);
      this.body.prepend(this.chart.element);
    }
    const target = Number(this.refinement.asked.target_error) || null;
    const column = (k: 1 | 2) => curve.map((row) => row[k] || null);
    this.chart.show(
      curve.map(([pseudo]) => pseudo),
      [column(2), column(1), curve.map(() => target)],
    );
  }
}

function askedText({ asked }: Refinement): string {
  const { target_error, max_pseudo, budget_s, method, weighted_by_traffic } = asked;
  const traffic = weighted_by_traffic ? ", weighted by traffic" : "";
  return `Asked: ${percent(Number(target_error))}, ${max_pseudo} pseudo-examples, ${budget_s} s, ${method}${traffic}`;
}
