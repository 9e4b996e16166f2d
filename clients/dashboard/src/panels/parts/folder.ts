/** A folder of a verb's source, made one zip. */

import { type Zippable, zipSync } from "fflate";

const MOST_FILES = 2000;
const MOST_BYTES = 256 * 1024 * 1024;
const LEVEL = 1;

export interface Inside {
  path: string;
  file: File;
}

/** All files of a folder that was dropped, but for hidden ones. */
export async function filesIn(folder: FileSystemDirectoryEntry): Promise<Inside[]> {
  const found: Inside[] = [];
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

/** All files of a folder that was chosen, but for hidden ones. */
export function filesOf(list: FileList): Inside[] {
  const all = [...list].map((file) => ({ path: file.webkitRelativePath, file }));
  return all.filter(({ path }) => !path.split("/").some((name) => name.startsWith(".")));
}

/** The zip; an error where it cannot be the source of a verb. */
export async function zipped(files: readonly Inside[]): Promise<File> {
  const name = files[0]?.path.split("/")[0] ?? "The folder";
  const source = "It should be the folder of one verb, with verb.toml and the motions.";
  if (!files.some(({ path }) => /^([^/]+\/)?verb\.toml$/.test(path)))
    throw new Error(`${name} holds no verb.toml. ${source}`);
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
    if (some.length === 0) return entries; // a reader gives a hundred at a time
    entries.push(...some);
  }
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((found, failed) => entry.file(found, failed));
}
