/** Notices, and the overlay for missing content. */

import type { Page } from "../app";
import { missing } from "../panels/parts/scoped";
import { h } from "./dom";

const NOTE_MS = 5000;
const MOST = 4;

/** Notices disappear after a few seconds; errors stay until dismissed. */
export function notices(page: Page): HTMLElement {
  const list = h("div", { className: "notices", role: "log", "aria-label": "Notices" });
  page.on("notice", ({ text, kind }) => {
    if ([...list.children].some((row) => row.firstChild?.textContent === text)) return;
    const row = h("div", { className: `notice ${kind}` }, h("span", {}, text));
    const dismiss = () => row.remove();
    row.append(h("button", { type: "button", className: "plain", "aria-label": "Dismiss", onclick: dismiss }, "×"));
    list.append(row);
    while (list.children.length > MOST) list.firstChild?.remove();
    if (kind === "note") setTimeout(dismiss, NOTE_MS);
  });
  return list;
}

/** Overlay while loading, without verbs, or without connection; the last picture stays greyed out. */
export function overlay(page: Page, scene: HTMLElement): HTMLElement {
  const title = h("strong", {}, "Loading…");
  const detail = h("span", {});
  const upload = h(
    "button",
    { type: "button", hidden: true, onclick: () => page.store.change({ panel: "upload" }, true) },
    "Upload a verb",
  );
  const element = h("div", { className: "overlay", role: "status" }, title, detail, upload);
  let failure = "";
  const show = () => {
    const { access, connection } = page;
    const denied = access.problem === null && !access.may("pose");
    const offline = !denied && (connection === "lost" || (connection === "connecting" && failure !== ""));
    const empty = page.loaded && page.verbs.length === 0;
    scene.classList.toggle("offline", offline || denied);
    element.hidden = !denied && !offline && !empty && page.shown.main !== null;
    upload.hidden = denied || offline || !empty;
    if (denied) {
      title.textContent = "No stream";
      detail.textContent = missing("pose");
      return;
    }
    title.textContent =
      access.problem !== null
        ? "A key is needed"
        : offline
          ? "No connection to the server; retrying…"
          : empty
            ? "No verbs"
            : "Loading…";
    detail.textContent =
      access.problem ?? (offline ? failure : empty ? "Upload a verb, or start the server with --data." : "");
  };
  page.on("connection", () => {
    if (page.connection === "open") failure = "";
    show();
  });
  page.on("offline", ({ detail: reason }) => {
    failure = reason;
    show();
  });
  page.on("access", show);
  page.on("verbs", show);
  page.on("verb", show);
  page.on("frame", () => {
    if (!element.hidden) show();
  });
  return element;
}
