/** Controls that need a scope: disabled with the reason while the key does not have it. */

import type { Scope } from "../../access/access";
import { h } from "../../shell/dom";
import type { App } from "../../types";

export function missing(scope: Scope): string {
  return `This needs a key with the scope “${scope}”.`;
}

/** @param reason where it is shown: above the controls, or as their title */
export function scoped(app: App, scope: Scope, reason: "text" | "title", ...controls: HTMLElement[]) {
  const note = reason === "text" ? h("p", { className: "quiet" }, missing(scope)) : null;
  const element = h("fieldset", { className: "scoped" }, note, ...controls);
  const show = () => {
    const allowed = app.access.may(scope);
    element.disabled = !allowed;
    element.title = allowed ? "" : missing(scope);
    note?.toggleAttribute("hidden", allowed);
  };
  const dispose = app.on("access", show);
  show();
  return { element, dispose };
}
