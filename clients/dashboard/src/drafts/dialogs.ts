/** Dialogs of a draft: publish and delete. */

import { h } from "../shell/dom";
import type { VerbSummary } from "../types";

/** Ask for the verb's name; null if cancelled. */
export function askPublish(host: HTMLElement, name: string, verbs: readonly VerbSummary[]): Promise<string | null> {
  const input = h("input", { type: "text", value: name, required: true, "aria-label": "Name of the verb" });
  const note = h("p", { className: "quiet", role: "status" });
  const publish = h("button", { type: "submit", className: "primary" }, "Publish");
  const show = () => {
    const known = verbs.find((verb) => verb.name === input.value.trim());
    note.textContent = known
      ? `${known.name} exists as version ${known.version}. The draft becomes its next version; older versions are kept.`
      : "The draft becomes version 1 of a new verb.";
    publish.textContent = known ? "Publish new version" : "Publish";
  };
  input.oninput = show;
  show();
  const content = [h("label", { className: "field" }, h("span", {}, "Name of the verb"), input), note];
  return ask(host, "Publish", content, publish, () => input.value.trim());
}

/** Ask whether a draft is to be deleted. */
export async function askDelete(host: HTMLElement, name: string): Promise<boolean> {
  const text = h("p", {}, `The draft “${name}” and its clips are deleted from the server. Published verbs stay.`);
  const button = h("button", { type: "submit", className: "primary" }, "Delete draft");
  return (await ask(host, "Delete draft", [text], button, () => "yes")) !== null;
}

function ask(
  host: HTMLElement,
  title: string,
  content: readonly HTMLElement[],
  accept: HTMLElement,
  value: () => string,
): Promise<string | null> {
  return new Promise((answer) => {
    let result: string | null = null;
    const cancel = h("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
    const form = h("form", { method: "dialog" }, ...content, h("div", { className: "actions" }, accept, cancel));
    const dialog = h("dialog", { className: "draft-dialog", "aria-label": title }, h("h2", {}, title), form);
    form.onsubmit = () => {
      result = value();
    };
    dialog.onclose = () => {
      dialog.remove();
      answer(result || null);
    };
    host.append(dialog);
    dialog.showModal();
  });
}
