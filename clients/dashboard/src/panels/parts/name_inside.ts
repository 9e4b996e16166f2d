/** The name of the verb in a file that is to be uploaded; null where it cannot be read here (the server says why). */

const LONGEST_HEADER = 16 * 1024 * 1024;
const LONGEST_TOML = 1024 * 1024;
const END = 0x06054b50;
const ENTRY = 0x02014b50;
const ENTRY_BYTES = 46;
const END_BYTES = 22;
const LONGEST_COMMENT = 65_535;
const STORED = 0;
const DEFLATED = 8;

export async function nameInside(file: Blob): Promise<string | null> {
  try {
    const start = new Uint8Array(await file.slice(0, 2).arrayBuffer());
    return start[0] === 0x50 && start[1] === 0x4b ? nameInToml(await tomlOf(file)) : await nameInArtifact(file);
  } catch {
    return null;
  }
}

/** An artifact is a safetensors file: the length of a JSON header, then that header. See docs/artifact.md. */
async function nameInArtifact(file: Blob): Promise<string | null> {
  const length = Number((await view(file, 0, 8)).getBigUint64(0, true));
  if (length > Math.min(LONGEST_HEADER, file.size)) return null;
  const header = JSON.parse(await file.slice(8, 8 + length).text());
  const { name } = JSON.parse(header.__metadata__.adverb) as { name?: unknown };
  return typeof name === "string" ? name : null;
}

/** The key `name` above the first table. */
function nameInToml(text: string): string | null {
  const [top = ""] = text.split(/^\s*\[/m);
  const found = /^\s*name\s*=\s*(?:"([^"\\]*)"|'([^']*)')/m.exec(top);
  return found?.[1] ?? found?.[2] ?? null;
}

/** `verb.toml` out of a zip. Source: PKWARE, APPNOTE.TXT, sections 4.3.7, 4.3.12 and 4.3.16. */
async function tomlOf(file: Blob): Promise<string> {
  const from = Math.max(0, file.size - END_BYTES - LONGEST_COMMENT);
  const tail = await view(file, from, file.size - from);
  let end = tail.byteLength - END_BYTES;
  while (end > 0 && tail.getUint32(end, true) !== END) end--;
  const [size, start] = [tail.getUint32(end + 12, true), tail.getUint32(end + 16, true)];
  const directory = await view(file, start, size);
  for (let at = 0; at + ENTRY_BYTES <= size && directory.getUint32(at, true) === ENTRY; ) {
    const lengths = [28, 30, 32].map((field) => directory.getUint16(at + field, true));
    const [nameLength = 0] = lengths;
    const name = new TextDecoder().decode(new Uint8Array(directory.buffer, at + ENTRY_BYTES, nameLength));
    if (/^(?!__MACOSX\/)(.*\/)?verb\.toml$/.test(name)) return content(file, directory, at);
    at += ENTRY_BYTES + lengths.reduce((sum, each) => sum + each, 0);
  }
  throw new Error("the archive holds no verb.toml");
}

async function content(file: Blob, directory: DataView, at: number): Promise<string> {
  const method = directory.getUint16(at + 10, true);
  const [packed, full, local] = [20, 24, 42].map((field) => directory.getUint32(at + field, true)) as [
    number,
    number,
    number,
  ];
  if (full > LONGEST_TOML || (method !== STORED && method !== DEFLATED)) throw new Error("it is packed unusually");
  const head = await view(file, local, 30);
  const from = local + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  const bytes = file.slice(from, from + packed);
  if (method === STORED) return bytes.text();
  return new Response(bytes.stream().pipeThrough(new DecompressionStream("deflate-raw"))).text();
}

async function view(file: Blob, from: number, length: number): Promise<DataView> {
  return new DataView(await file.slice(from, from + length).arrayBuffer());
}
