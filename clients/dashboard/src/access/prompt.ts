/** Dialog that prompts for a key; it stays until the server accepts one. */

import { h } from "../shell/dom";
import type { Access } from "./access";

const COMMAND = "adverb keys create --scope pose --name page";

export function keyPrompt(access: Access): HTMLDialogElement {
  const input = h("input", { type: "password", id: "key", required: true, autocomplete: "off", spellcheck: false });
  const failure = h("p", { className: "failure", role: "alert", id: "key-failure", hidden: true });
  const reason = h("p", { className: "quiet" });
  const button = h("button", { type: "submit", className: "primary" }, "Continue");
  input.setAttribute("aria-describedby", "key-failure");
  const fail = (text: string) => {
    failure.textContent = text;
    failure.hidden = text === "";
    input.ariaInvalid = String(text !== "");
  };
  const onsubmit = async (event: Event) => {
    event.preventDefault();
    button.disabled = true;
    try {
      await access.give(input.value);
      fail("");
    } catch (err) {
      fail(problemText(err));
      input.select();
    }
    button.disabled = false;
  };
  const form = h(
    "form",
    { onsubmit },
    h("label", { className: "field" }, h("span", {}, "Key"), input),
    failure,
    h("div", { className: "actions" }, button),
  );
  const dialog = h(
    "dialog",
    { className: "key-prompt", "aria-labelledby": "key-title" },
    h("h2", { id: "key-title" }, "This server needs a key"),
    reason,
    form,
    about(),
  );
  const show = () => {
    const { problem } = access;
    reason.textContent = problem === null || access.key === "" ? "" : `The key is not valid any more: ${problem}.`;
    reason.hidden = reason.textContent === "";
    if (problem === null && dialog.open) {
      input.value = "";
      fail("");
      dialog.close();
    } else if (problem !== null && !dialog.open && dialog.isConnected) dialog.showModal();
  };
  dialog.oncancel = (event) => event.preventDefault();
  dialog.onclose = show; // a browser closes a dialog on the second Escape
  access.on(show);
  return dialog;
}

function about(): HTMLElement {
  return h(
    "div",
    { className: "quiet" },
    h("p", {}, "A key is a text that starts with adv_. The operator of the server makes one, with its scopes:"),
    h("code", {}, COMMAND),
    h("p", {}, "It is kept until this tab is closed."),
  );
}

function problemText(err: unknown): string {
  const text = err instanceof Error ? err.message : String(err);
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}`;
}
