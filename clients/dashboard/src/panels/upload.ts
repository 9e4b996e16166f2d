/** Upload tab: clips become a draft; a source folder, zip or artifact is built by the server and published. */

import { AdverbError } from "adverb-client";
import { textOf } from "../app";
import { h } from "../shell/dom";
import type { App, Upload, VerbSummary } from "../types";
import { bytes } from "../units";
import { Disposables } from "./parts/disposables";
import { draftList } from "./parts/draft_list";
import { type FolderFile, isSource, readChosen, readDropped, zipClips, zipSource } from "./parts/folder";
import { scoped } from "./parts/scoped";
import { SerialQueue } from "./parts/serial_queue";
import { isZipOfClips, readVerbName } from "./parts/verb_name";

const TICK_MS = 250;
/** Files that hold a whole verb or folder. */
const PACKED = /\.(zip|verb)$/i;

const NEEDS = [
  "Motion clips: BVH, GLB, glTF or npz, all with the same joints. Other lengths, units, axes and frame rates are found.",
  "Without verb.toml they become a draft: keytimes and adverbs are proposed, and you correct them here.",
  "With verb.toml the folder is built and published at once.",
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
  const enqueue = (file: File, clips: boolean) => {
    const status = addStatus();
    const task = async () => {
      if (clips) return makeDraft(status, app, file, stop.signal);
      const expected = await confirmReplace(status, app, file);
      if (expected !== "no" && !stop.signal.aborted) await upload(status, app, file, expected, stop.signal);
    };
    if (queue.add(task)) showQueued(status, file, () => queue.remove(task));
  };
  const pack = async (files: FolderFile[] | Promise<FolderFile[]>) => {
    try {
      const found = await files;
      const source = isSource(found);
      enqueue(await (source ? zipSource(found) : zipClips(found)), !source);
    } catch (err) {
      showError(addStatus(), err);
    }
  };
  const take = async (files: DataTransfer | FileList | null) => {
    const list = files instanceof DataTransfer ? files.files : files;
    const entries = files instanceof DataTransfer ? [...files.items].map((item) => item.webkitGetAsEntry()) : [];
    const [file] = list ?? [];
    if (!list || !file) return;
    const packed = [...list].filter(({ name }) => PACKED.test(name));
    if (packed.length === 0 && entries.every((entry) => entry !== null))
      await pack(entries.length > 0 ? readDropped(entries) : readChosen(list));
    else if (list.length > 1)
      showStatus(addStatus(), "bad", "Upload one zip or artifact at a time, without other files.");
    else enqueue(file, await isZipOfClips(file));
  };
  const folder = async (list: FileList | null) => {
    if (list && list.length > 0) await pack(readChosen(list));
  };
  const choose = scoped(
    app,
    "author",
    "text",
    dropZone((files) => app.access.may("author") && void take(files)),
    folderPicker((list) => void folder(list)),
  );
  host.append(choose.element, list, draftList(app, disposables), needs(app));
  disposables.add(choose.dispose, () => stop.abort());
  return () => disposables.dispose();
}

function dropZone(take: (files: DataTransfer | FileList | null) => void): HTMLElement {
  const input = h("input", {
    type: "file",
    accept: ".bvh,.glb,.gltf,.bin,.npz,.csv,.zip,.verb,application/zip",
    multiple: true,
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
    h("strong", {}, "Drop clips or a verb here, or choose files"),
    h("span", { className: "quiet" }, "clips (BVH, GLB, glTF, npz), a folder, a zip, or a .verb file"),
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

function needs(app: App): HTMLElement {
  const docs = h(
    "a",
    { href: "/docs#upload_verb", target: "_blank", rel: "noopener" },
    "Upload route in the API reference",
  );
  return h(
    "section",
    {},
    h("h2", {}, "What can be uploaded"),
    h("ul", { className: "needs" }, ...NEEDS.map((line) => h("li", {}, line))),
    app.access.key === "" && docs, // a link cannot send a key
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
  await withProgress(status, file, "Building", stop, async (progress, signal) => {
    const made = await app.rest.uploadFile(file, progress, signal, expected);
    await app.reload();
    showResult(status, app, made);
  });
}

/** Upload clips as a draft and open it. */
async function makeDraft(status: HTMLElement, app: App, file: File, stop: AbortSignal): Promise<void> {
  const name = file.name.replace(/\.zip$/i, "");
  await withProgress(status, file, "Reading clips and proposing keytimes", stop, async (progress, signal) => {
    const { id } = await app.rest.drafts.create(file, name, progress, signal);
    app.store.change({ draft: id, clip: "" }, true);
    status.remove();
  });
}

/** Show the progress of an upload, then the time that the server takes; `task` replaces it by its result. */
async function withProgress(
  status: HTMLElement,
  file: File,
  work: string,
  stop: AbortSignal,
  task: (progress: (share: number) => void, signal: AbortSignal) => Promise<void>,
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
    else text.textContent = `${work}… ${((performance.now() - sentMs) / 1000).toFixed(0)} s`;
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
    await task(progress, AbortSignal.any([cancel.signal, stop]));
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
  const readOnly = err instanceof AdverbError && err.code === "read_only";
  showStatus(status, "bad", readOnly ? `Read-only: ${err.detail}.` : textOf(err));
}

function showStatus(status: HTMLElement, state: "good" | "warn" | "bad", text: string): void {
  status.replaceChildren(h("p", { className: "dot-line", "data-state": state }, text));
}
