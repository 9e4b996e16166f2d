/** Container of a verb file (docs/artifact.md): safetensors with the facts of the verb, and its checksum. */

import { ArtifactError } from "../errors.js";

/** Newest format that is read. */
export const FORMAT = 2;

const MAX_HEADER_BYTES = 16 * 1024 * 1024;
const DTYPES = {
  F32: { bytes: 4, numpy: "<f4" },
  F64: { bytes: 8, numpy: "<f8" },
  I64: { bytes: 8, numpy: "<i8" },
} as const;

type Dtype = keyof typeof DTYPES;

/** One array of a file, in C order. */
export interface StoredArray {
  dtype: Dtype;
  shape: readonly number[];
  /** I64 is converted to numbers. */
  data: Float32Array | Float64Array;
  bytes: Uint8Array<ArrayBuffer>;
}

export interface Container {
  /** JSON value: name, adverbs, joints, … */
  facts: Record<string, unknown>;
  arrays: ReadonlyMap<string, StoredArray>;
  /** Text of the facts. */
  text: string;
}

interface Entry {
  dtype: Dtype;
  shape: number[];
  data_offsets: [number, number];
}

/**
 * Read a container, without checking the checksum.
 *
 * @throws ArtifactError it is not a verb file, is cut off, or has a newer format
 */
export function readContainer(content: ArrayBuffer | Uint8Array): Container {
  const file = aligned(content);
  if (file.byteLength < 16) throw new ArtifactError("not a verb file: it is too short");
  const length = Number(new DataView(file).getBigUint64(0, true));
  if (length < 2 || length > MAX_HEADER_BYTES || length > file.byteLength - 8)
    throw new ArtifactError("not a verb file: it is not a safetensors file");
  let header: Record<string, Entry>;
  let text: string;
  let facts: unknown;
  try {
    const parsed = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(file, 8, length)));
    const { __metadata__: metadata, ...rest } = parsed as { __metadata__: { adverb: string } };
    text = metadata.adverb;
    facts = JSON.parse(text);
    header = rest as unknown as Record<string, Entry>;
  } catch {
    throw new ArtifactError("not a verb file: its header is invalid");
  }
  if (typeof facts !== "object" || facts === null) throw new ArtifactError("not a verb file: its header is invalid");
  const { format } = facts as { format?: unknown };
  if (!Number.isInteger(format) || (format as number) < 1)
    throw new ArtifactError("the format is not a positive integer");
  if ((format as number) > FORMAT)
    throw new ArtifactError(`the file has format ${format}; this package reads up to ${FORMAT}: upgrade it`);
  const start = 8 + length;
  const arrays = new Map(
    Object.entries(header).map(([name, entry]) => [name, readArray(file, start, name, entry)] as const),
  );
  return { facts: facts as Record<string, unknown>, arrays, text };
}

/**
 * Compare the checksum of a container with its content. Without `crypto.subtle`, as on pages that are not secure, there
 * is no check.
 *
 * @returns whether the checksum was compared
 * @throws ArtifactError the file is damaged
 */
export async function verify({ facts, arrays, text }: Container): Promise<boolean> {
  const subtle = globalThis.crypto?.subtle;
  if (!subtle) return false;
  const encoder = new TextEncoder();
  const parts = [encoder.encode(withoutChecksum(text))];
  for (const name of [...arrays.keys()].sort(byCodePoint)) {
    const { dtype, shape, bytes } = arrays.get(name) as StoredArray;
    const sides = shape.length === 1 ? `${shape[0]},` : shape.join(", ");
    parts.push(encoder.encode(`\n${name}:${DTYPES[dtype].numpy}:(${sides})\n`), bytes);
  }
  const digest = new Uint8Array(await subtle.digest("SHA-256", joined(parts)));
  const found = [...digest].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  if (found !== facts.sha256) throw new ArtifactError("the checksum does not match: the file is damaged");
  return true;
}

function aligned(content: ArrayBuffer | Uint8Array): ArrayBuffer {
  if (content instanceof ArrayBuffer) return content;
  return new Uint8Array(content).buffer; // a copy, which starts at 0
}

function readArray(file: ArrayBuffer, start: number, name: string, { dtype, shape, data_offsets }: Entry): StoredArray {
  const kind = DTYPES[dtype];
  if (!kind) throw new ArtifactError(`array '${name}' has the type ${String(dtype).slice(0, 20)}`);
  const sides = [...shape, ...data_offsets];
  if (shape.length > 4 || data_offsets.length !== 2 || !sides.every((side) => Number.isSafeInteger(side) && side >= 0))
    throw new ArtifactError(`array '${name}' has an impossible shape`);
  const [begin, end] = data_offsets;
  const count = shape.reduce((product, side) => product * side, 1);
  const from = start + begin;
  if (end - begin !== count * kind.bytes || start + end > file.byteLength || from % kind.bytes !== 0)
    throw new ArtifactError(`array '${name}' does not fit into the file`);
  const data =
    dtype === "F32"
      ? new Float32Array(file, from, count)
      : dtype === "F64"
        ? new Float64Array(file, from, count)
        : Float64Array.from(new BigInt64Array(file, from, count), Number);
  for (const value of data)
    if (!Number.isFinite(value)) throw new ArtifactError(`array '${name}' has a number that is not finite`);
  return { dtype, shape, data, bytes: new Uint8Array(file, from, end - begin) };
}

/** The text without the entry `sha256` of its outermost object, whose keys are sorted. */
function withoutChecksum(text: string): string {
  let depth = 0;
  for (let k = 0; k < text.length; k++) {
    const character = text[k];
    if (character === "{" || character === "[") depth++;
    else if (character === "}" || character === "]") depth--;
    else if (character === '"') {
      const end = endOfString(text, k);
      if (depth === 1 && text.slice(k, end + 2) === '"sha256":') {
        const after = endOfString(text, text.indexOf('"', end + 1)) + 1;
        return text[after] === ","
          ? text.slice(0, k) + text.slice(after + 2)
          : text.slice(0, k - 2) + text.slice(after);
      }
      k = end;
    }
  }
  throw new ArtifactError("the file has no checksum");
}

/** Position of the quotation mark that ends the string which starts at `k`. */
function endOfString(text: string, k: number): number {
  let end = k + 1;
  while (end < text.length && text[end] !== '"') end += text[end] === "\\" ? 2 : 1;
  return end;
}

function byCodePoint(a: string, b: string): number {
  return a < b ? -1 : a > b ? 1 : 0;
}

function joined(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}
