/** Name of the verb in an upload; null if unreadable (the server reports the reason). */

import { unzipSync } from "fflate";

const LONGEST_HEADER = 16 * 1024 * 1024;
const LONGEST_TOML = 1024 * 1024;
const TOML = /^(?!__MACOSX\/)(.*\/)?verb\.toml$/;
const CLIP = /\.(bvh|glb|gltf|npz)$/i;

export async function readVerbName(file: Blob): Promise<string | null> {
  try {
    const start = new Uint8Array(await file.slice(0, 2).arrayBuffer());
    return start[0] === 0x50 && start[1] === 0x4b ? nameInToml(await tomlOf(file)) : await nameInArtifact(file);
  } catch {
    return null;
  }
}

/** Whether a file is a zip of clips without `verb.toml`. */
export async function isZipOfClips(file: Blob): Promise<boolean> {
  const start = new Uint8Array(await file.slice(0, 2).arrayBuffer());
  if (start[0] !== 0x50 || start[1] !== 0x4b) return false;
  let [clips, source] = [false, false];
  try {
    unzipSync(new Uint8Array(await file.arrayBuffer()), {
      filter: ({ name }) => {
        clips ||= CLIP.test(name);
        source ||= TOML.test(name);
        return false;
      },
    });
  } catch {
    return false; // the server reports the reason
  }
  return clips && !source;
}

/** An artifact is a safetensors file: header length, then a JSON header. See docs/artifact.md. */
async function nameInArtifact(file: Blob): Promise<string | null> {
  const length = Number((await view(file, 0, 8)).getBigUint64(0, true));
  if (length > Math.min(LONGEST_HEADER, file.size)) return null;
  const header = JSON.parse(await file.slice(8, 8 + length).text());
  const { name } = JSON.parse(header.__metadata__.adverb) as { name?: unknown };
  return typeof name === "string" ? name : null;
}

/** The key `name` before the first table. */
function nameInToml(text: string): string | null {
  const [top = ""] = text.split(/^\s*\[/m);
  const found = /^\s*name\s*=\s*(?:"([^"\\]*)"|'([^']*)')/m.exec(top);
  return found?.[1] ?? found?.[2] ?? null;
}

/** Extract `verb.toml` from a zip. */
async function tomlOf(file: Blob): Promise<string> {
  const found = unzipSync(new Uint8Array(await file.arrayBuffer()), {
    filter: ({ name, originalSize }) => TOML.test(name) && originalSize <= LONGEST_TOML,
  });
  const [content] = Object.values(found);
  if (!content) throw new Error("no verb.toml in the archive");
  return new TextDecoder().decode(content);
}

async function view(file: Blob, from: number, length: number): Promise<DataView> {
  return new DataView(await file.slice(from, from + length).arrayBuffer());
}
