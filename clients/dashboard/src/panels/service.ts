/** How the service is doing, and this page's own stream. */

import { textOf } from "../app";
import { h } from "../shell/dom";
import type { App, Ready, Stats } from "../types";
import { Life } from "./parts/disposables";
import { History } from "./parts/history";
import { between, type Measures, type Scrape, scrapeOf } from "./parts/server_metrics";
import { bytes, counted, digits } from "./parts/units";

const EVERY_MS = 1000;
const HIDDEN_MS = 5000;
/** Readiness is asked for once in so many scrapes. */
const READY_EACH = 5;

export function mount(host: HTMLElement, app: App): () => void {
  const life = new Life();
  const history = new History();
  const watch = new Watch(app, (measures) => history.add(measures));
  host.append(
    h("section", { "aria-label": "Server" }, serverLine(app, life), watch.health, watch.failure),
    h("h2", {}, "This page’s stream"),
    streamNumbers(app, life),
    h("h2", {}, "Server, last 5 minutes"),
    history.element,
  );
  life.add(
    () => watch.stop(),
    () => history.dispose(),
  );
  return () => life.end();
}

/** Looks at the server's metrics every second, and now and then at whether it is ready. */
class Watch {
  readonly health = h("div", { className: "health" });
  readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private readonly stopped = new AbortController();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private before: Scrape | null = null;
  private turn = 0;

  constructor(
    private readonly app: App,
    private readonly tell: (measures: Measures) => void,
  ) {
    void this.look();
  }

  stop(): void {
    this.stopped.abort();
    clearTimeout(this.timer);
  }

  private async look(): Promise<void> {
    const { signal } = this.stopped;
    try {
      await this.scrape(signal);
      this.failure.hidden = true;
    } catch (err) {
      this.before = null;
      this.turn = 0;
      this.failure.textContent = textOf(err);
      this.failure.hidden = false;
    }
    if (!signal.aborted) this.timer = setTimeout(() => void this.look(), document.hidden ? HIDDEN_MS : EVERY_MS);
  }

  private async scrape(signal: AbortSignal): Promise<void> {
    const { rest } = this.app;
    if (this.turn++ % READY_EACH === 0) this.health.replaceChildren(...healthLines(await rest.ready(signal)));
    const now = scrapeOf(await rest.metrics(signal), performance.now() / 1000);
    if (signal.aborted) return;
    if (this.before) this.tell(between(this.before, now));
    this.before = now;
  }
}

function serverLine(app: App, life: Life): HTMLElement {
  const version = h("span", {}, "Adverb");
  app.rest.json<{ info: { version: string } }>("/openapi.json").then(
    ({ info }) => life.over || version.replaceChildren(`Adverb, API version ${info.version}`),
    () => {}, // the line below says that nobody answers
  );
  const docs = h("a", { href: "/docs", target: "_blank", rel: "noopener" }, "API reference");
  return h("p", { className: "server-line" }, version, docs);
}

/** While the store is away verbs are served as they were. */
function healthLines({ degraded, problem, verbs, skipped }: Ready): HTMLElement[] {
  const state = degraded
    ? `Degraded: ${problem ?? "verbs are served as they were"}`
    : `Ready, ${counted(verbs, "verb")}`;
  const files = skipped.map(({ file, problem: why }) => h("li", {}, h("strong", {}, file), ` is not served: ${why}`));
  const lines = [h("p", { className: "dot-line", "data-state": degraded ? "warn" : "good" }, state)];
  return files.length > 0 ? [...lines, h("ul", { className: "skipped" }, ...files)] : lines;
}

const NUMBERS: readonly (readonly [string, (stats: Stats) => string])[] = [
  ["messages", (stats) => `${digits(stats.messages_per_s)}/s`],
  ["poses", (stats) => `${digits(stats.poses_per_s)}/s`],
  ["received", (stats) => `${bytes(stats.bytes_per_s)}/s`],
  ["late p50", (stats) => ms(stats.lateness_p50_ms)],
  ["late p95", (stats) => ms(stats.lateness_p95_ms)],
  ["late p99", (stats) => ms(stats.lateness_p99_ms)],
  ["round trip", (stats) => ms(stats.round_trip_ms)],
  ["shown later by", (stats) => ms(stats.buffer_ms)],
  ["channels", (stats) => String(stats.channels)],
  ["left out", (stats) => String(stats.dropped)],
  ["gaps", (stats) => String(stats.gaps)],
  ["reconnected", (stats) => String(stats.reconnects)],
];

function streamNumbers(app: App, life: Life): HTMLElement {
  const values = NUMBERS.map(() => h("dd", {}, "–"));
  const connection = h("p", { className: "dot-line" });
  const show = () => {
    connection.dataset.state = app.connection === "open" ? "good" : app.connection === "connecting" ? "warn" : "bad";
    connection.textContent = app.connection === "open" ? "connected" : app.connection;
    const { stats } = app;
    if (stats) for (const [k, [, of]] of NUMBERS.entries()) values[k]?.replaceChildren(of(stats));
  };
  life.add(app.on("stats", show), app.on("connection", show));
  show();
  const cells = NUMBERS.map(([name], k) => h("div", {}, h("dt", {}, name), values[k] ?? null));
  return h("div", {}, connection, h("dl", { className: "numbers" }, ...cells));
}

function ms(value: number): string {
  return Number.isFinite(value) ? `${digits(value)} ms` : "–";
}
