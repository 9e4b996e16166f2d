/** What the page has to say: in passing, or over the scene where there is nothing to see. */

import type { Page } from "../app";
import { h } from "./dom";

const NOTE_MS = 5000;
const MOST = 4;

/** Short notices that go by themselves; errors wait to be dismissed. */
export function notices(page: Page): HTMLElement {
  const list = h("div", { className: "notices", role: "log", "aria-label": "Notices" });
  page.on("say", ({ text, kind }) => {
    if ([...list.children].some((row) => row.firstChild?.textContent === text)) return;
    const row = h("div", { className: `notice ${kind}` }, h("span", {}, text));
    const go = () => row.remove();
    row.append(h("button", { type: "button", className: "plain", "aria-label": "Dismiss", onclick: go }, "×"));
    list.append(row);
    while (list.children.length > MOST) list.firstChild?.remove();
    if (kind === "note") setTimeout(go, NOTE_MS);
  });
  return list;
}

/** Over the scene: loading, nothing served, nobody answers. What was shown stays, greyed. */
export function veil(page: Page, scene: HTMLElement): HTMLElement {
  const title = h("strong", {}, "Loading…");
  const detail = h("span", {});
  const add = h(
    "button",
    { type: "button", hidden: true, onclick: () => page.store.change({ panel: "add" }) },
    "Add one",
  );
  const element = h("div", { className: "veil", role: "status" }, title, detail, add);
  let failure = "";
  const show = () => {
    const { connection } = page;
    const away = connection === "lost" || (connection === "connecting" && failure !== "");
    const empty = page.answered && page.verbs.length === 0;
    scene.classList.toggle("away", away);
    element.hidden = !away && !empty && page.shown.main !== null;
    add.hidden = away || !empty;
    title.textContent = away ? "The server does not answer; trying again…" : empty ? "No verb is served" : "Loading…";
    detail.textContent = away ? failure : empty ? "Add one from capture, or start the server with a data folder." : "";
  };
  page.on("connection", () => {
    if (page.connection === "open") failure = "";
    show();
  });
  page.on("offline", (why) => {
    failure = why.detail;
    show();
  });
  page.on("verbs", show);
  page.on("verb", show);
  page.on("frame", () => {
    if (!element.hidden) show();
  });
  return element;
}
