/** Changes of verbs with their authors, for keys with the scope `admin`. */

import { textOf } from "../../app";
import { choice, h, setOptions } from "../../shell/dom";
import type { App, Change } from "../../types";
import type { Disposables } from "./disposables";
import { ageText, changeText } from "./labels";

const PAGE = 20;
const ALL = "";

/** Loaded when it is opened; hidden without the scope. */
export function changesPart(app: App, disposables: Disposables): HTMLElement {
  const list = new Changes(app, disposables);
  const element = h("details", { className: "changes" }, h("summary", {}, "Changes"), list.element);
  const show = () => {
    element.hidden = app.access.caller === null || !app.access.may("admin");
    if (element.hidden) element.open = false;
  };
  element.ontoggle = () => list.setOpen(element.open);
  disposables.add(app.on("access", show));
  show();
  return element;
}

class Changes {
  readonly element: HTMLElement;
  private readonly list = h("ol", { className: "versions-list", "aria-label": "Changes" });
  private readonly failure = h("p", { className: "failure", role: "alert", hidden: true });
  private readonly none = h("p", { className: "quiet", hidden: true }, "No changes.");
  private readonly older = h("button", { type: "button", onclick: () => void this.load(this.last) }, "Older changes");
  private readonly filter = choice("Verb", [[ALL, "all verbs"]], () => void this.load());
  /** Verbs that can be selected: those that are served, and deleted ones that were listed. */
  private readonly verbs = new Set<string>();
  private last: number | undefined;
  private open = false;
  private request = 0;

  constructor(
    private readonly app: App,
    disposables: Disposables,
  ) {
    this.element = h(
      "div",
      {},
      this.filter.element,
      this.failure,
      this.none,
      this.list,
      h("div", { className: "actions" }, this.older),
    );
    disposables.add(
      app.on("verbs", () => void this.load()),
      () => this.setOpen(false),
    );
  }

  setOpen(open: boolean): void {
    this.open = open;
    this.request++;
    if (open) void this.load();
  }

  /** Load the newest page, or the one before a number. */
  private async load(before?: number): Promise<void> {
    if (!this.open) return;
    const request = ++this.request;
    const verb = this.filter.select.value;
    this.older.disabled = true;
    try {
      const query = { limit: PAGE, ...(verb !== ALL && { verb }), ...(before !== undefined && { before }) };
      const changes = await this.app.rest.changes(query);
      if (request !== this.request) return;
      this.failure.hidden = true;
      this.show(changes, before === undefined);
    } catch (err) {
      if (request !== this.request) return;
      this.failure.textContent = textOf(err);
      this.failure.hidden = false;
    }
    this.older.disabled = false;
  }

  private show(changes: readonly Change[], first: boolean): void {
    if (first) this.list.replaceChildren();
    this.list.append(...changes.map(row));
    this.last = changes.at(-1)?.id;
    this.older.hidden = changes.length < PAGE;
    this.none.hidden = this.list.childElementCount > 0;
    for (const { name } of this.app.verbs) this.verbs.add(name);
    for (const { verb } of changes) this.verbs.add(verb);
    setOptions(this.filter.select, [
      [ALL, "all verbs"],
      ...[...this.verbs].sort().map((verb) => [verb, verb] as const),
    ]);
  }
}

function row(change: Change): HTMLElement {
  const at = new Date(1000 * change.at);
  const age = ageText(Date.now() / 1000 - change.at);
  return h(
    "li",
    { className: "version-row", "data-kind": change.kind },
    h(
      "div",
      { className: "version-head" },
      h("strong", {}, changeText(change)),
      h("time", { dateTime: at.toISOString(), title: at.toLocaleString() }, age),
    ),
    h("p", { className: "quiet" }, [change.author, change.reason].filter(Boolean).join(": ")),
  );
}
