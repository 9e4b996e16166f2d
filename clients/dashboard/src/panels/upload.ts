/** Upload tab: a source folder, zip or artifact is uploaded, built by the server and shown. */

import { Problem } from "../api/rest";
import { textOf } from "../app";
import { h } from "../shell/dom";
import type { App, Upload, VerbSummary } from "../types";
import { bytes } from "../units";
import { Disposables } from "./parts/disposables";
import { type FolderFile, readChosenFolder, readDroppedFolder, zipFolder } from "./parts/folder";
import { SerialQueue } from "./parts/serial_queue";
import { readVerbName } from "./parts/verb_name";

const TICK_MS = 250;

const NEEDS = [
  "verb.toml with the verb's name, and the motion files.",
  "One BVH file per example, all with the same skeleton.",
  "Adverbs: name, unit, and a value in every example.",
  "Keytimes in seconds: the same names in the same order in every example.",
  "For measured adverbs: the measure, its effector and its keytime.",
];

export function mount(host: HTMLElement, app: App): () => void {
  const disposables = new Disposables();
  const stop = new AbortController();
  const queue = new SerialQueue();
  const list = h("div", { className: "uploads" });

  /** Status element of one upload, above those of earlier ones. */
  const addStatus = () => {
    const status = h("div", { className: "upload", role: "status" });
    list.prepend(status);
    return status;
  };
  const enqueue = (file: File) => {
    const status = addStatus();
    const task = async () => {
      const expected = await confirmReplace(status, app, file);
      if (expected !== "no" && !stop.signal.aborted) await upload(status, app, file, expected, stop.signal);
    };
    if (queue.add(task)) showQueued(status, file, () => queue.remove(task));
  };
  const pack = async (files: FolderFile[] | Promise<FolderFile[]>) => {
    try {
      enqueue(await zipFolder(await files));
    } catch (err) {
      showError(addStatus(), err);
    }
  };
  const take = async (files: DataTransfer | FileList | null) => {
    const list = files instanceof DataTransfer ? files.files : files;
    const file = list?.[0];
    if (!file) return;
    const entry = files instanceof DataTransfer ? files.items[0]?.webkitGetAsEntry() : null;
    if (list.length > 1) showStatus(addStatus(), "bad", "Upload one verb at a time: one folder, zip or artifact.");
    else if (entry?.isDirectory) await pack(readDroppedFolder(entry as FileSystemDirectoryEntry));
    else enqueue(file);
  };
  const folder = async (list: FileList | null) => {
    if (list && list.length > 0) await pack(readChosenFolder(list));
  };
  host.append(
    dropZone((files) => void take(files)),
    folderPicker((list) => void folder(list)),
    list,
    needs(),
  );
  disposables.add(() => stop.abort());
  return () => disposables.dispose();
}

function dropZone(take: (files: DataTransfer | FileList | null) => void): HTMLElement {
  const input = h("input", {
    type: "file",
    accept: ".zip,.verb,application/zip",
    className: "visually-hidden",
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
    h("strong", {}, "Drop a verb here or choose a file"),
    h("span", { className: "quiet" }, "source folder, zip of a source folder, or .verb file"),
  );
  return zone;
}

/** Browsers need a separate input to choose a folder. */
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
  return h("div", { className: "actions" }, input, button);
}

function needs(): HTMLElement {
  const docs = h(
    "a",
    { href: "/docs#upload_verb", target: "_blank", rel: "noopener" },
    "Upload route in the API reference",
  );
  return h(
    "section",
    {},
    h("h2", {}, "Contents of a source folder"),
    h("ul", { className: "needs" }, ...NEEDS.map((line) => h("li", {}, line))),
    docs,
  );
}

/** The version that the upload may replace, undefined for a new verb; `no` if the user declines. */
async function confirmReplace(status: HTMLElement, app: App, file: File): Promise<number | undefined | "no"> {
  const name = await readVerbName(file);
  const known = app.verbs.find((verb) => verb.name === name);
  if (!known) return undefined;
  const next = await nextVersion(app, known);
  return new Promise((answer) => {
    const accept = () => answer(known.version);
    const decline = () => {
      status.remove();
      answer("no");
    };
    const publish = h("button", { type: "button", className: "primary", onclick: accept }, `Publish as v${next}`);
    const cancel = h("button", { type: "button", onclick: decline }, "Cancel");
    showStatus(
      status,
      "warn",
      `${known.name} exists as version ${known.version}. The upload becomes version ${next}; older versions are kept.`,
    );
    status.append(h("div", { className: "actions" }, publish, cancel));
    publish.focus();
  });
}

/** Number of the next version: a rolled back verb has newer versions than its current one. */
async function nextVersion({ rest }: App, { name, version }: VerbSummary): Promise<number> {
  const { versions } = await rest.versions(name).catch(() => ({ versions: [] }));
  return Math.max(version, ...versions.map((each) => each.version)) + 1;
}

async function upload(
  status: HTMLElement,
  app: App,
  file: File,
  expected: number | undefined,
  stop: AbortSignal,
): Promise<void> {
  const text = h("span", {});
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" });
  const cancel = new AbortController();
  const button = h("button", { type: "button", onclick: () => cancel.abort() }, "Cancel");
  status.replaceChildren(text, bar, h("div", { className: "actions" }, button));
  let share = 0;
  let sentMs = 0;
  const show = () => {
    if (share < 1) text.textContent = `Uploading ${file.name}, ${(100 * share).toFixed(0)} % of ${bytes(file.size)}`;
    else text.textContent = `Building… ${((performance.now() - sentMs) / 1000).toFixed(0)} s`;
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
    showResult(status, app, made);
  } catch (err) {
    showError(status, err);
  } finally {
    clearInterval(timer);
  }
}

function showResult(status: HTMLElement, app: App, { verb, version, warnings }: Upload): void {
  const known = app.verbs.find(({ name }) => name === verb);
  const examples = known ? `, ${known.examples} examples` : "";
  showStatus(status, "good", `Published ${verb} v${version}${examples}`);
  if (warnings.length > 0)
    status.append(h("ul", { className: "skipped" }, ...warnings.map((line) => h("li", {}, line))));
  const fresh = { method: "", goal: {}, phase: 0, camera: null, across: "", up: "", slice: null };
  const onclick = () => app.store.change({ verb, ...fresh, compare: { kind: "none" }, panel: "verb" }, true);
  status.append(
    h("div", { className: "actions" }, h("button", { type: "button", className: "primary", onclick }, "Open")),
  );
}

function showQueued(status: HTMLElement, file: File, remove: () => void): void {
  showStatus(status, "warn", `${file.name} is queued and starts after the running upload.`);
  const onclick = () => {
    remove();
    status.remove();
  };
  status.append(h("div", { className: "actions" }, h("button", { type: "button", onclick }, "Cancel")));
}

function showError(status: HTMLElement, err: unknown): void {
  if (err instanceof DOMException && err.name === "AbortError") return status.remove();
  const readOnly = err instanceof Problem && err.code === "read_only";
  showStatus(status, "bad", readOnly ? `Read-only: ${err.detail}.` : textOf(err));
}

function showStatus(status: HTMLElement, state: "good" | "warn" | "bad", text: string): void {
  status.replaceChildren(h("p", { className: "dot-line", "data-state": state }, text));
}
