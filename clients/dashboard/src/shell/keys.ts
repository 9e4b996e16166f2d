/** Keyboard shortcuts and their dialog. */

import type { Page } from "../app";
import { h } from "./dom";

const KEYS = [
  ["Space", "play or pause"],
  ["← →", "previous or next frame; with Shift, 10 frames"],
  ["↑ ↓", "change the focused adverb"],
  ["1 – 9", "select a verb"],
  ["W S A D", "in drive mode: forward, back, turn; with Shift, run"],
  ["Q E", "in drive mode: side-step"],
  ["Space J K", "in drive mode: jump, punch, kick"],
  ["f", "follow the figure on or off"],
  ["r", "reset the view"],
  ["?", "show this list"],
] as const;

/** Elements with own keyboard input. */
const TYPING = "input[type=number], input[type=text], input[type=search], select, textarea, dialog";

export function shortcutDialog(): HTMLDialogElement {
  const rows = KEYS.flatMap(([key, meaning]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, meaning)]);
  const close = h("button", { type: "button", onclick: () => dialog.close() }, "Close");
  const dialog = h(
    "dialog",
    { className: "keys", "aria-label": "Keyboard shortcuts" },
    h("h2", {}, "Keyboard shortcuts"),
    h("dl", {}, ...rows),
    close,
  );
  dialog.onclick = (event) => {
    if (event.target === dialog) dialog.close();
  };
  return dialog;
}

export function bindKeys(page: Page, resetView: () => void, help: () => void): void {
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
    if (page.store.view.draft && event.key !== "?") return; // drafts have their own keys
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest(TYPING)) return;
    if (event.key === " " && target.closest("button, [type=checkbox], summary, a")) return;
    const verb = /^[1-9]$/.test(event.key) ? page.verbs[Number(event.key) - 1] : undefined;
    const action = actions[event.key] ?? (verb && (() => page.selectVerb(verb.name)));
    if (!action || (event.key.startsWith("Arrow") && target.closest("[role=tablist], input[type=range]"))) return;
    event.preventDefault();
    action(event);
  });
}

/** Step by frames at the streamed rate. */
function step(page: Page, frames: number): void {
  const { view } = page.store;
  const shown = page.shown.main;
  if (!shown) return;
  const from = view.playing ? shown.phase : view.phase;
  const phase = from + frames / (view.fps * Math.max(shown.durationS, 1e-3));
  page.seek(page.verb?.looping ? phase - Math.floor(phase) : phase);
}
