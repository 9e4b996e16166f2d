/** List of the drafts on the server, with links that open them. */

import { AdverbError } from "adverb-client";
import { textOf } from "../../app";
import type { DraftSummary } from "../../drafts/types";
import { h } from "../../shell/dom";
import type { App } from "../../types";
import { countText } from "../../units";
import type { Disposables } from "./disposables";
import { ageText } from "./labels";

/** Problems that the upload above states. */
const STATED = new Set(["read_only", "missing_scope"]);

export function draftList(app: App, disposables: Disposables): HTMLElement {
  const list = h("ul", { className: "versions-list", "aria-label": "Drafts" });
  const failure = h("p", { className: "quiet", hidden: true });
  const element = h("section", { hidden: true }, h("h2", {}, "Drafts"), failure, list);
  const load = async () => {
    element.hidden = !app.access.may("author");
    if (element.hidden) return;
    try {
      const drafts = await app.rest.drafts.list();
      list.replaceChildren(...drafts.map((draft) => row(app, draft)));
      element.hidden = drafts.length === 0;
      failure.hidden = true;
    } catch (err) {
      const stated = err instanceof AdverbError && STATED.has(err.code);
      element.hidden = stated;
      failure.textContent = textOf(err);
      failure.hidden = false;
    }
  };
  disposables.add(
    app.store.on(["draft"], () => void load()),
    app.on("access", () => void load()),
  );
  void load();
  return element;
}

function row(app: App, { id, name, clips, excluded, changed_at, built }: DraftSummary): HTMLElement {
  const open = (event: Event) => {
    event.preventDefault();
    app.store.change({ draft: id, clip: "" }, true);
  };
  const left = excluded > 0 ? `, ${excluded} excluded` : "";
  return h(
    "li",
    { className: "version-row" },
    h(
      "div",
      { className: "version-head" },
      h("a", { href: `#draft=${encodeURIComponent(id)}`, onclick: open }, name),
      h("time", { dateTime: new Date(1000 * changed_at).toISOString() }, ageText(Date.now() / 1000 - changed_at)),
    ),
    h("span", { className: "quiet" }, `${countText(clips, "clip")}${left}${built ? "" : ", no verb yet"}`),
  );
}
