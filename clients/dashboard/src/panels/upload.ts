/** Add a verb: its source as a folder or a zip, or an artifact, dropped or picked; built by the server, then shown. */

import { Problem } from "../api/rest";
import { textOf } from "../app";
import { h } from "../shell/dom";
import type { App, Upload } from "../types";
import { Life } from "./parts/disposables";
import { filesIn, filesOf, type Inside, zipped } from "./parts/folder";
import { bytes } from "./parts/units";
import { nameInside } from "./parts/verb_name";

const TICK_MS = 250;

const NEEDS = [
  "A file verb.toml with a name, and the motion files beside it.",
  "One BVH file to an example, all of one skeleton.",
  "Adverbs: a name and a unit each, and their values in every example.",
  "Keytimes in seconds: the same instants, in the same order, in every example.",
  "For measured adverbs: what is measured, the effector and its keytime.",
];

export function mount(host: HTMLElement, app: App): () => void {
  const life = new Life();
  const stop = new AbortController();
  const said = h("div", { className: "upload", role: "status" });
  let busy = false;

  const send = async (file: File) => {
    if (busy) return;
    busy = true;
    try {
      const expected = await agreed(said, app, file);
      if (expected !== "no") await upload(said, app, file, expected, stop.signal);
    } finally {
      busy = false;
    }
  };
  const pack = async (files: Inside[] | Promise<Inside[]>) => {
    try {
      await send(await zipped(await files));
    } catch (err) {
      explain(said, err);
    }
  };
  const take = async (files: DataTransfer | FileList | null) => {
    const list = files instanceof DataTransfer ? files.files : files;
    const file = list?.[0];
    if (busy || !file) return;
    const entry = files instanceof DataTransfer ? files.items[0]?.webkitGetAsEntry() : null;
    if (list.length > 1) say(said, "bad", "One at a time: a verb is one folder, one zip or one artifact.");
    else if (entry?.isDirectory) await pack(filesIn(entry as FileSystemDirectoryEntry));
    else await send(file);
  };
  const folder = async (list: FileList | null) => {
    if (!busy && list && list.length > 0) await pack(filesOf(list));
  };
  host.append(
    dropZone((files) => void take(files)),
    folderPicker((list) => void folder(list)),
    said,
    needs(),
  );
  life.add(() => stop.abort());
  return () => life.end();
}

function dropZone(take: (files: DataTransfer | FileList | null) => void): HTMLElement {
  const input = h("input", {
    type: "file",
    accept: ".zip,.verb,application/zip",
    className: "unseen",
    onchange: () => {
      take(input.files);
      input.value = "";
    },
  });
  const over = (event: DragEvent, on: boolean) => {
    event.preventDefault();
    zone.classList.toggle("over", on);
  };
  const zone = h(
    "label",
    {
      className: "drop",
      ondragover: (event) => over(event, true),
      ondragleave: (event) => over(event, false),
      ondrop: (event) => {
        over(event, false);
        take(event.dataTransfer);
      },
    },
    input,
    h("strong", {}, "Drop a verb here, or choose a file"),
    h("span", { className: "quiet" }, "its source folder, a zip of that, or a .verb file"),
  );
  return zone;
}

/** Folders cannot be chosen where files are: they have a button of their own. */
function folderPicker(take: (files: FileList | null) => void): HTMLElement {
  const input = h("input", {
    type: "file",
    webkitdirectory: true,
    hidden: true,
    onchange: () => {
      const { files } = input;
      take(files);
      input.value = "";
    },
  });
  const button = h("button", { type: "button", onclick: () => input.click() }, "Choose a folder");
  return h("div", { className: "acts" }, input, button);
}

function needs(): HTMLElement {
  const docs = h("a", { href: "/docs#upload_verb", target: "_blank", rel: "noopener" }, "Uploads in the API reference");
  return h(
    "section",
    {},
    h("h2", {}, "What a source folder needs"),
    h("ul", { className: "needs" }, ...NEEDS.map((line) => h("li", {}, line))),
    docs,
  );
}

/** The version that the upload may replace, none where the verb is new; `no` where the user said so. */
async function agreed(said: HTMLElement, app: App, file: File): Promise<number | undefined | "no"> {
  const name = await nameInside(file);
  const known = app.verbs.find((verb) => verb.name === name);
  if (!known) return undefined;
  return new Promise((answer) => {
    const replace = () => answer(known.version);
    const leave = () => {
      said.replaceChildren();
      answer("no");
    };
    const yes = h("button", { type: "button", className: "primary", onclick: replace }, "Replace it");
    const no = h("button", { type: "button", onclick: leave }, "Leave it");
    say(said, "warn", `${known.name} exists as version ${known.version}. Replace it? The old version is kept.`);
    said.append(h("div", { className: "acts" }, yes, no));
    yes.focus();
  });
}

async function upload(
  said: HTMLElement,
  app: App,
  file: File,
  expected: number | undefined,
  stop: AbortSignal,
): Promise<void> {
  const words = h("span", {});
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" });
  const cancel = new AbortController();
  const button = h("button", { type: "button", onclick: () => cancel.abort() }, "Cancel");
  said.replaceChildren(words, bar, h("div", { className: "acts" }, button));
  let share = 0;
  let sentMs = 0;
  const show = () => {
    if (share < 1) words.textContent = `Sending ${file.name}, ${(100 * share).toFixed(0)} % of ${bytes(file.size)}`;
    else words.textContent = `Building… ${((performance.now() - sentMs) / 1000).toFixed(0)} s`;
    if (share < 1) bar.value = share;
    else bar.removeAttribute("value");
  };
  const progress = (done: number) => {
    if (done >= 1 && share < 1) sentMs = performance.now();
    share = done;
    show();
  };
  const timer = setInterval(show, TICK_MS);
  try {
    const made = await app.rest.upload(file, progress, AbortSignal.any([cancel.signal, stop]), expected);
    await app.reload();
    tell(said, app, made);
  } catch (err) {
    explain(said, err);
  } finally {
    clearInterval(timer);
  }
}

function tell(said: HTMLElement, app: App, { verb, version, warnings }: Upload): void {
  const known = app.verbs.find(({ name }) => name === verb);
  const examples = known ? `, ${known.examples} examples` : "";
  say(said, "good", `${verb}, version ${version}${examples}`);
  if (warnings.length > 0) said.append(h("ul", { className: "skipped" }, ...warnings.map((line) => h("li", {}, line))));
  const fresh = { method: "", goal: {}, phase: 0, camera: null, across: "", up: "", slice: null };
  const onclick = () => app.store.change({ verb, ...fresh, against: { kind: "nothing" }, panel: "verb" });
  said.append(
    h("div", { className: "acts" }, h("button", { type: "button", className: "primary", onclick }, "Show it")),
  );
}

function explain(said: HTMLElement, err: unknown): void {
  if (err instanceof DOMException && err.name === "AbortError") return said.replaceChildren();
  const readOnly = err instanceof Problem && err.code === "read_only";
  say(said, "bad", readOnly ? `Read-only: ${err.detail}.` : textOf(err));
}

function say(said: HTMLElement, state: "good" | "warn" | "bad", text: string): void {
  said.replaceChildren(h("p", { className: "dot-line", "data-state": state }, text));
}
