/** Packs a source folder as a zip archive. */

import { type Zippable, zipSync } from "fflate";

const MOST_FILES = 2000;
const MOST_BYTES = 256 * 1024 * 1024;
const LEVEL = 1;

export interface FolderFile {
  path: string;
  file: File;
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

/** All files of a chosen folder, without hidden files. */
export function readChosenFolder(list: FileList): FolderFile[] {
  const all = [...list].map((file) => ({ path: file.webkitRelativePath, file }));
  return all.filter(({ path }) => !path.split("/").some((name) => name.startsWith(".")));
}

/** Zip the files. Throws if they cannot be a verb source. */
export async function zipFolder(files: readonly FolderFile[]): Promise<File> {
  const name = files[0]?.path.split("/")[0] ?? "The folder";
  const source = "Choose the folder of one verb, with verb.toml and its motion files.";
  if (!files.some(({ path }) => /^([^/]+\/)?verb\.toml$/.test(path)))
    throw new Error(`${name} contains no verb.toml. ${source}`);
  const size = files.reduce((sum, { file }) => sum + file.size, 0);
  if (files.length > MOST_FILES || size > MOST_BYTES)
    throw new Error(`${name} is larger than ${MOST_FILES} files or ${MOST_BYTES / 1024 ** 2} MB. ${source}`);
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
