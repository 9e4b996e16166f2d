/** The key of this tab: name, scopes and end, and the button that removes it. */

import { h } from "../../shell/dom";
import type { App } from "../../types";
import type { Disposables } from "./disposables";
import { callerText } from "./labels";

export function accessPart(app: App, disposables: Disposables): HTMLElement {
  const text = h("p", {});
  const forget = h("button", { type: "button", onclick: () => app.forgetKey() }, "Forget the key");
  forget.title = "Remove the key from this tab";
  const element = h(
    "section",
    { "aria-label": "Key of this tab" },
    h("h2", {}, "Key of this tab"),
    text,
    h("div", { className: "actions" }, forget),
  );
  const show = () => {
    const { caller, key } = app.access;
    element.hidden = key === "";
    text.textContent = caller === null ? "…" : callerText(caller);
  };
  disposables.add(app.on("access", show));
  show();
  return element;
}
