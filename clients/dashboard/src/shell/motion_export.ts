/** Downloads of the motion in view, and requests for it to copy. */

import type { MotionType } from "adverb-client";
import { type Page, textOf } from "../app";
import type { SequenceRequest } from "../types";
import { adverbsByName, adverbValues } from "../verb";
import { h } from "./dom";
import { saveAs } from "./download";
import { LANGUAGES, type Language, snippet } from "./snippets";

const FORMATS = [
  ["bvh", "text/x-bvh", "BVH: text, for most animation programs"],
  ["glb", "model/gltf-binary", "glTF: skeleton, animation and a simple body"],
  ["vrma", "application/x-vrma", "VRM animation, for avatars; needs a humanoid skeleton"],
  ["npz", "application/x-npz", "NumPy arrays"],
] as const;
const FPS = 30;

export function motionExport(page: Page): HTMLElement {
  const status = h("div", { role: "status" });
  const buttons = [
    ...FORMATS.map(([form, accept, title]) => button(form, title, () => void download(form, accept))),
    ...LANGUAGES.map((language) => button(language, `Copy the request as ${language}`, () => void copy(language))),
  ];
  const download = async (form: string, accept: MotionType) => {
    const [verb, request] = wantedOf(page) ?? [];
    if (!verb || !request) return;
    try {
      const content = await page.rest.sequence(verb, { ...request, mannequin: true }, undefined, accept);
      saveAs(new Blob([content], { type: accept }), `${verb}.${form}`);
      status.replaceChildren(h("p", { className: "quiet" }, `Downloaded ${verb}.${form}`));
    } catch (err) {
      status.replaceChildren(h("p", { className: "failure", role: "alert" }, textOf(err)));
    }
  };
  const copy = async (language: Language) => {
    const [verb, request] = wantedOf(page) ?? [];
    if (!verb || !request) return;
    const text = snippet(language, { server: location.origin, verb, request, keyed: page.access.key !== "" });
    const code = h(
      "pre",
      { className: "snippet", role: "region", tabIndex: 0, "aria-label": `Request as ${language}` },
      text,
    );
    const copied = await copyText(text);
    const line = copied ? "Copied:" : "This page may not write to the clipboard; select the text:";
    status.replaceChildren(h("p", { className: "quiet" }, line), code);
  };
  const show = () => {
    for (const each of buttons) each.disabled = wantedOf(page) === null;
  };
  page.on("verb", () => {
    status.replaceChildren();
    show();
  });
  page.store.on(["goal"], show);
  show();
  const row = (label: string, ...members: HTMLElement[]) =>
    h("div", { className: "export-row", role: "group", "aria-label": label }, h("span", {}, label), ...members);
  return h(
    "div",
    { className: "motion-export" },
    row("Download this motion", ...buttons.slice(0, FORMATS.length)),
    row("Copy as", ...buttons.slice(FORMATS.length)),
    status,
  );
}

function button(text: string, title: string, onclick: () => void): HTMLButtonElement {
  return h("button", { type: "button", title, onclick }, text);
}

/** Verb and request of the goal in view; null before they are known. */
export function wantedOf({ verb, store: { view } }: Pick<Page, "verb" | "store">): [string, SequenceRequest] | null {
  if (!verb || verb.name !== view.verb) return null;
  const values = adverbValues(verb, view.goal);
  if (values.length === 0) return null;
  const adverbs = adverbsByName(verb, values);
  return [verb.name, { adverbs, fps: FPS, ...(view.method && { method: view.method }) }];
}

/** Copy text; returns whether the browser did it, which it does on secure addresses only. */
async function copyText(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}
