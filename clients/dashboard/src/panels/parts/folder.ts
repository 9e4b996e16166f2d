/** Packs a source folder, or loose clips, as a zip archive. */

import { type Zippable, zipSync } from "fflate";

const MOST_FILES = 2000;
const MOST_BYTES = 256 * 1024 * 1024;
const LEVEL = 1;
const CLIP = /\.(bvh|glb|gltf|npz)$/i;
/** Buffers of glTF files, and style adverbs. */
const BESIDE = /\.(bin|csv)$/i;
const TOML = /^([^/]+\/)?verb\.toml$/;
/** Shorter common beginnings of file names are no name. */
const LEAST_NAME = 3;

export interface FolderFile {
  path: string;
  file: File;
}

/** All files of dropped files and folders, without hidden files. */
export async function readDropped(entries: readonly FileSystemEntry[]): Promise<FolderFile[]> {
  const found: FolderFile[] = [];
  for (const entry of entries) {
    if (entry.isDirectory) found.push(...(await readDroppedFolder(entry as FileSystemDirectoryEntry)));
    else if (!entry.name.startsWith("."))
      found.push({ path: entry.name, file: await fileOf(entry as FileSystemFileEntry) });
  }
  return found;
}

/** All files of a dropped folder, without hidden files. */
export async function readDroppedFolder(folder: FileSystemDirectoryEntry): Promise<FolderFile[]> {
  const found: FolderFile[] = [];
  const waiting = [folder];
  for (let next = waiting.pop(); next; next = waiting.pop()) {
    for (const entry of await entriesOf(next)) {
      if (entry.name.startsWith(".")) continue;
      if (entry.isDirectory) waiting.push(entry as FileSystemDirectoryEntry);
      else found.push({ path: entry.fullPath.slice(1), file: await fileOf(entry as FileSystemFileEntry) });
    }
    if (found.length > MOST_FILES) break;
  }
  return found;
}

/** All files of a chosen folder or of a choice of files, without hidden files. */
export function readChosen(list: FileList): FolderFile[] {
  const all = [...list].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
  return all.filter(({ path }) => !path.split("/").some((name) => name.startsWith(".")));
}

/** Whether the files are a verb source: they have a `verb.toml` at their top. */
export function isSource(files: readonly FolderFile[]): boolean {
  return files.some(({ path }) => TOML.test(path));
}

/** Zip a verb source. */
export async function zipSource(files: readonly FolderFile[]): Promise<File> {
  const name = files.find(({ path }) => path.includes("/"))?.path.split("/")[0] ?? "verb";
  return zipOf(name, files);
}

/** Zip loose clips and what belongs to them, at the top of the archive. Throws without a clip. */
export async function zipClips(files: readonly FolderFile[]): Promise<File> {
  const clips = files.filter(({ path }) => CLIP.test(path));
  if (clips.length === 0)
    throw new Error("No clips found. Drop BVH, GLB, glTF or npz files, or a folder that contains them.");
  const used = files.filter(({ path }) => CLIP.test(path) || BESIDE.test(path));
  const flat = used.map(({ path, file }) => ({ path: path.slice(path.lastIndexOf("/") + 1), file }));
  const names = flat.map(({ path }) => path);
  const twice = names.find((name, k) => names.indexOf(name) !== k);
  if (twice) throw new Error(`Two files are named ${twice}. Rename one of them.`);
  return zipOf(nameOf(clips.map(({ path }) => path)), flat);
}

/** Name of a verb for clips: that of their folder, or the beginning that their file names share. */
export function nameOf(paths: readonly string[]): string {
  const folders = new Set(paths.map((path) => path.split("/").at(-2) ?? ""));
  const [folder = ""] = folders.size === 1 ? folders : [];
  const stems = paths.map((path) => path.slice(path.lastIndexOf("/") + 1).replace(CLIP, ""));
  const shared = stems.reduce((common, stem) => {
    let k = 0;
    while (k < common.length && common[k] === stem[k]) k++;
    return common.slice(0, k);
  });
  return verbName(folder) || (shared.length >= LEAST_NAME && verbName(shared)) || "draft";
}

/** A valid name of a verb like `text`; empty if there is none. */
function verbName(text: string): string {
  return text
    .toLowerCase()
    .replace(/[^a-z0-9_]+/g, "-")
    .replace(/^[^a-z]+|[-_]+$/g, "");
}

async function zipOf(name: string, files: readonly FolderFile[]): Promise<File> {
  const size = files.reduce((sum, { file }) => sum + file.size, 0);
  if (files.length > MOST_FILES || size > MOST_BYTES)
    throw new Error(`${name} is larger than ${MOST_FILES} files or ${MOST_BYTES / 1024 ** 2} MB. Choose one verb.`);
  const content: Zippable = {};
  for (const { path, file } of files) content[path] = new Uint8Array(await file.arrayBuffer());
  return new File([zipSync(content, { level: LEVEL })], `${name}.zip`, { type: "application/zip" });
}

async function entriesOf(folder: FileSystemDirectoryEntry): Promise<FileSystemEntry[]> {
  const reader = folder.createReader();
  const entries: FileSystemEntry[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((found, failed) => reader.readEntries(found, failed));
    if (some.length === 0) return entries; // readEntries returns at most 100 entries per call
    entries.push(...some);
  }
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((found, failed) => entry.file(found, failed));
}
