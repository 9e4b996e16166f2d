/** Keys for the whole page, and the list that tells them. */

import type { Page } from "../app";
import { h } from "./dom";

const KEYS = [
  ["Space", "play or pause"],
  ["← →", "a frame back or on; with shift ten"],
  ["↑ ↓", "the adverb whose slider has the focus"],
  ["1 – 9", "pick a verb"],
  ["f", "follow the figure, or not"],
  ["r", "reset the view"],
  ["?", "this list"],
] as const;

/** Elements that use keys themselves. */
const TYPING = "input[type=number], input[type=text], input[type=search], select, textarea, dialog";

export function keyList(): HTMLDialogElement {
  const rows = KEYS.flatMap(([key, meaning]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, meaning)]);
  const close = h("button", { type: "button", onclick: () => dialog.close() }, "Close");
  const dialog = h(
    "dialog",
    { className: "keys", "aria-label": "Keys" },
    h("h2", {}, "Keys"),
    h("dl", {}, ...rows),
    close,
  );
  dialog.onclick = (event) => {
    if (event.target === dialog) dialog.close();
  };
  return dialog;
}

export function listen(page: Page, resetView: () => void, help: () => void): void {
  const actions: Record<string, (event: KeyboardEvent) => void> = {
    " ": () => (page.store.view.playing ? page.pause() : page.play()),
    ArrowLeft: ({ shiftKey }) => step(page, shiftKey ? -10 : -1),
    ArrowRight: ({ shiftKey }) => step(page, shiftKey ? 10 : 1),
    f: () => page.store.change({ follow: !page.store.view.follow }),
    r: resetView,
    "?": help,
  };
  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest(TYPING)) return;
    if (event.key === " " && target.closest("button, [type=checkbox], summary, a")) return;
    const verb = /^[1-9]$/.test(event.key) ? page.verbs[Number(event.key) - 1] : undefined;
    const action = actions[event.key] ?? (verb && (() => page.choose(verb.name)));
    if (!action || (event.key.startsWith("Arrow") && target.closest("[role=tablist], input[type=range]"))) return;
    event.preventDefault();
    action(event);
  });
}

/** So many frames on, at the rate that is streamed. */
function step(page: Page, frames: number): void {
  const { view } = page.store;
  const shown = page.shown.main;
  if (!shown) return;
  const from = view.playing ? shown.phase : view.phase;
  const phase = from + frames / (view.fps * Math.max(shown.duration_s, 1e-3));
  page.seek(page.verb?.looping ? phase - Math.floor(phase) : phase);
}
