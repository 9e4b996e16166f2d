/** Service tab: server health, charts, and this page's stream. */

import { retryMs } from "adverb-client";
import { textOf } from "../app";
import { h } from "../shell/dom";
import { download } from "../shell/download";
import { CONNECTION_LABELS } from "../shell/header";
import type { App, Ready, Stats } from "../types";
import { bytes, countText, digits } from "../units";
import { accessPart } from "./parts/access_part";
import { Disposables } from "./parts/disposables";
import { History } from "./parts/history";
import { between, type Scrape, type ServerMetrics, scrapeOf } from "./parts/server_metrics";

const EVERY_MS = 1000;
const HIDDEN_MS = 5000;
/** Scrapes per readiness request. */
const SCRAPES_PER_READY = 5;

export function mount(host: HTMLElement, app: App): () => void {
  const disposables = new Disposables();
  const history = new History();
  const poller = new MetricsPoller(app, (metrics) => history.add(metrics));
  host.append(
    h("section", { "aria-label": "Server" }, serverLine(app, disposables), poller.health, poller.failure),
    accessPart(app, disposables),
    h("h2", {}, "This page’s stream"),
    streamNumbers(app, disposables),
    h("h2", {}, "Server, last 5 minutes"),
    history.element,
  );
  disposables.add(
    () => poller.stop(),
    () => history.dispose(),
  );
  return () => disposables.dispose();
}

/** Polls the metrics every second and readiness every few seconds. */
class MetricsPoller {
  readonly health = h("div", { className: "health" });
  readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private readonly stopped = new AbortController();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private before: Scrape | null = null;
  private scrapes = 0;

  constructor(
    private readonly app: App,
    private readonly onMetrics: (metrics: ServerMetrics) => void,
  ) {
    void this.poll();
  }

  stop(): void {
    this.stopped.abort();
    clearTimeout(this.timer);
  }

  private async poll(): Promise<void> {
    const { signal } = this.stopped;
    let everyMs = document.hidden ? HIDDEN_MS : EVERY_MS;
    try {
      await this.scrape(signal);
      this.failure.hidden = true;
    } catch (err) {
      everyMs = retryMs(err, everyMs);
      this.before = null;
      this.scrapes = 0;
      this.failure.textContent = textOf(err);
      this.failure.hidden = false;
    }
    if (!signal.aborted) this.timer = setTimeout(() => void this.poll(), everyMs);
  }

  private async scrape(signal: AbortSignal): Promise<void> {
    const { rest } = this.app;
    if (this.scrapes++ % SCRAPES_PER_READY === 0) this.health.replaceChildren(...healthLines(await rest.ready(signal)));
    const now = scrapeOf(await rest.metrics(signal), performance.now() / 1000);
    if (signal.aborted) return;
    if (this.before) this.onMetrics(between(this.before, now));
    this.before = now;
  }
}

function serverLine(app: App, disposables: Disposables): HTMLElement {
  const version = h("span", {}, "Adverb");
  app.rest.json<{ info: { version: string } }>("/openapi.json").then(
    ({ info }) => disposables.disposed || version.replaceChildren(`Adverb, API version ${info.version}`),
    () => {}, // the line below shows the connection error
  );
  return h("p", { className: "server-line" }, version, reference(app, disposables));
}

/** Link to the API reference; a link cannot send a key, so with one its source is downloaded instead. */
function reference(app: App, disposables: Disposables): HTMLElement {
  const link = h("a", { href: "/docs", target: "_blank", rel: "noopener" }, "API reference");
  const button = h("button", { type: "button", className: "more" }, "OpenAPI document");
  button.onclick = async () => {
    const problem = await download(app, "/openapi.json", "openapi.json");
    if (problem) app.notify(problem, "error");
  };
  const show = () => {
    link.hidden = app.access.key !== "";
    button.hidden = !link.hidden;
  };
  disposables.add(app.on("access", show));
  show();
  return h("span", {}, link, button);
}

/** A degraded server has no store and serves cached verbs. */
function healthLines({ degraded, problem, verbs, skipped }: Ready): HTMLElement[] {
  const state = degraded
    ? `Degraded: ${problem ?? "verbs are served from memory"}`
    : `Ready, ${countText(verbs, "verb")}`;
  const files = skipped.map(({ file, problem: reason }) =>
    h("li", {}, h("strong", {}, file), `: not loaded, ${reason}`),
  );
  const lines = [h("p", { className: "dot-line", "data-state": degraded ? "warn" : "good" }, state)];
  return files.length > 0 ? [...lines, h("ul", { className: "skipped" }, ...files)] : lines;
}

const NUMBERS: readonly (readonly [string, (stats: Stats) => string])[] = [
  ["Messages", (stats) => `${digits(stats.messagesPerS)}/s`],
  ["Poses", (stats) => `${digits(stats.posesPerS)}/s`],
  ["Received", (stats) => `${bytes(stats.bytesPerS)}/s`],
  ["Lateness p50", (stats) => ms(stats.latenessP50Ms)],
  ["Lateness p95", (stats) => ms(stats.latenessP95Ms)],
  ["Lateness p99", (stats) => ms(stats.latenessP99Ms)],
  ["Round trip", (stats) => ms(stats.roundTripMs)],
  ["Display delay", (stats) => ms(stats.bufferMs)],
  ["Channels", (stats) => String(stats.channels)],
  ["Dropped frames", (stats) => String(stats.dropped)],
  ["Sequence gaps", (stats) => String(stats.gaps)],
  ["Reconnections", (stats) => String(stats.reconnects)],
];

function streamNumbers(app: App, disposables: Disposables): HTMLElement {
  const values = NUMBERS.map(() => h("dd", {}, "–"));
  const connection = h("p", { className: "dot-line" });
  const show = () => {
    connection.dataset.state = app.connection === "open" ? "good" : app.connection === "connecting" ? "warn" : "bad";
    connection.textContent = CONNECTION_LABELS[app.connection];
    const { stats } = app;
    if (stats) for (const [k, [, of]] of NUMBERS.entries()) values[k]?.replaceChildren(of(stats));
  };
  disposables.add(app.on("stats", show), app.on("connection", show));
  show();
  const cells = NUMBERS.map(([name], k) => h("div", {}, h("dt", {}, name), values[k] ?? null));
  return h("div", {}, connection, h("dl", { className: "numbers" }, ...cells));
}

function ms(value: number): string {
  return Number.isFinite(value) ? `${digits(value)} ms` : "–";
}
