/** Adds a clip to the current verb: the server proposes its keytimes and publishes a new version. */

import { AdverbError } from "adverb-client";
import { type Page, textOf } from "../app";
import type { AddedExample } from "../drafts/types";
import { scoped } from "../panels/parts/scoped";
import { adverbUnit, digits } from "../units";
import { h } from "./dom";

export function addClip(page: Page): HTMLElement {
  const status = h("div", { role: "status" });
  const input = h("input", {
    type: "file",
    accept: ".bvh,.glb,.gltf,.npz",
    hidden: true,
    onchange: () => {
      const [file] = input.files ?? [];
      input.value = "";
      if (file) void add(file);
    },
  });
  const button = h("button", { type: "button", onclick: () => input.click() }, "Add a clip…");
  button.title = "Add an example to this verb; its keytimes are proposed from the others";
  const add = async (file: File) => {
    const { verb } = page;
    if (!verb) return;
    button.disabled = true;
    status.replaceChildren(h("p", { className: "quiet" }, `Adding ${file.name} to ${verb.name}…`));
    try {
      const added = await page.rest.drafts.addExample(verb.name, file);
      await page.reload();
      status.replaceChildren(...resultOf(page, added));
    } catch (err) {
      const text = err instanceof AdverbError && err.code === "no_source" ? NO_SOURCE : textOf(err);
      status.replaceChildren(h("p", { className: "failure", role: "alert" }, text));
    }
    button.disabled = false;
  };
  page.store.on(["verb"], () => status.replaceChildren());
  const control = scoped(page, "author", "text", input, button).element;
  return h("div", { className: "add-clip" }, control, status);
}

const NO_SOURCE =
  "The server has no source of this verb, only its artifact. Upload its folder, or make a draft of its clips.";

function resultOf(page: Page, { verb, version, warnings, example }: AddedExample): HTMLElement[] {
  const names = page.verb?.keytime_names ?? [];
  const keytimes = example.keytimes.map((at, k) => {
    const confidence = example.confidence[k];
    const sure = confidence === undefined || confidence === 1 ? "" : ` (confidence ${confidence.toFixed(2)})`;
    return `${names[k] ?? `keytime ${k + 1}`} ${at.toFixed(2)} s${sure}`;
  });
  const values = Object.entries(example.adverbs).map(([name, value]) => {
    const { text, factor } = adverbUnit(page.verb?.adverbs.find((adverb) => adverb.name === name)?.unit ?? "none");
    return `${name} ${digits(value * factor)} ${text}`.trim();
  });
  const proposed = [...keytimes, ...values].map((line) => h("li", {}, line));
  return [
    h("p", { className: "dot-line" }, `Added ${example.name}; published ${verb} v${version}`),
    h("ul", { className: "needs" }, ...proposed),
    ...(warnings.length > 0 ? [h("ul", { className: "skipped" }, ...warnings.map((line) => h("li", {}, line)))] : []),
  ];
}
