/** Pose messages and records (docs/wire.md), read in place with bounds checks. */

import { DecodeError } from "../errors.js";

export const MESSAGE_HEAD_BYTES = 20;
export const RECORD_HEAD_BYTES = 24;
export const FLAGS = { clamped: 1, inTransition: 2, newVersion: 4, last: 8 } as const;

/** The upper half of the flags: 0, or 1 + 14 × support. */
const SUPPORT_SHIFT = 4;
const SUPPORT_STEPS = 14;

const POSE_OP = 0x01;
const ADVERBS_OP = 0x10;
const BULK_ADVERBS_OP = 0x11;
/** Longest message that the server takes. */
const MOST_BYTES = 65_536;
const WIRE_VERSION = 1;
const ENCODINGS = ["f32", "q48", "weights", "q32"] as const;
const Q48_STEPS = 16383;
const Q32_STEPS = 511;

export type Encoding = (typeof ENCODINGS)[number];

/** Record layout of a channel, from `opened`. */
export interface Layout {
  encoding: Encoding;
  joints: number;
  recordBytes: number;
}

export interface MessageHead {
  records: number;
  sequence: number;
  /** Due time of the tick, ms since 1970 on the server's clock; exact to a quarter of a microsecond. */
  timeMs: number;
  dropped: number;
}

export interface RecordHead {
  /** Verb of the channel when the record arrived, if known; not in the record. */
  verb?: string;
  channel: number;
  flags: number;
  version: number;
  phase: number;
  timeS: number;
  /** NaN if not measured. */
  error: number;
  durationS: number;
}

/** Numbers per pose: root x, y, z, then x, y, z, w per joint. */
export function poseLength(joints: number): number {
  return 3 + 4 * joints;
}

export function layoutOf(encoding: Encoding, joints: number, recordBytes: number): Layout {
  const least =
    RECORD_HEAD_BYTES + { f32: 12 + 16 * joints, q48: 12 + 6 * joints, q32: 12 + 4 * joints, weights: 4 }[encoding];
  if (recordBytes < least || recordBytes % 4 !== 0)
    throw new DecodeError(
      0,
      `records of ${joints} joints as ${encoding} have at least ${least} bytes, not ${recordBytes}`,
    );
  return { encoding, joints, recordBytes };
}

export function readMessageHead(view: DataView): MessageHead {
  if (view.byteLength < MESSAGE_HEAD_BYTES)
    throw new DecodeError(view.byteLength, `a pose message has at least ${MESSAGE_HEAD_BYTES} bytes`);
  if (view.getUint8(0) !== POSE_OP) throw new DecodeError(0, `op ${view.getUint8(0)} is not a pose message`);
  if (view.getUint8(1) !== WIRE_VERSION)
    throw new DecodeError(1, `wire version ${view.getUint8(1)} is not ${WIRE_VERSION}`);
  return {
    records: view.getUint16(2, true),
    sequence: view.getUint32(4, true),
    timeMs: (view.getUint32(12, true) * 2 ** 32) / 1e6 + view.getUint32(8, true) / 1e6,
    dropped: view.getUint32(16, true),
  };
}

/** Channel of the record at a byte offset; selects its layout. */
export function readChannel(view: DataView, at: number): number {
  if (at + RECORD_HEAD_BYTES > view.byteLength)
    throw new DecodeError(view.byteLength, `a record is missing at byte ${at}`);
  return view.getUint16(at, true);
}

/** Check that the records of a message end with it. */
export function checkEnd(view: DataView, at: number): void {
  if (at !== view.byteLength) throw new DecodeError(at, `${view.byteLength - at} bytes after the last record`);
}

/** Read the record head at a byte offset, and check its size and encoding. */
export function readRecordHead(view: DataView, at: number, layout: Layout): RecordHead {
  if (at + layout.recordBytes > view.byteLength)
    throw new DecodeError(view.byteLength, `the record at byte ${at} needs ${layout.recordBytes} bytes`);
  const encoding = ENCODINGS[view.getUint8(at + 2)];
  if (encoding !== layout.encoding)
    throw new DecodeError(at + 2, `encoding ${view.getUint8(at + 2)} where ${layout.encoding} was requested`);
  const head = {
    channel: view.getUint16(at, true),
    flags: view.getUint8(at + 3),
    version: view.getUint32(at + 4, true),
    phase: view.getFloat32(at + 8, true),
    timeS: view.getFloat32(at + 12, true),
    error: view.getFloat32(at + 16, true),
    durationS: view.getFloat32(at + 20, true),
  };
  if (!Number.isFinite(head.phase + head.timeS + head.durationS)) throw new DecodeError(at + 8, "a time is not finite");
  return head;
}

/** How well the examples support a pose, 0 to 1; null where its record does not have it. */
export function supportOf(flags: number): number | null {
  const stored = flags >> SUPPORT_SHIFT;
  return stored === 0 ? null : (stored - 1) / SUPPORT_STEPS;
}

/** Read the pose of the record at a byte offset into `out` at `offset`. */
export function readPose(view: DataView, at: number, layout: Layout, out: Float32Array, offset: number): void {
  const start = at + RECORD_HEAD_BYTES;
  const length = poseLength(layout.joints);
  if (offset < 0 || offset + length > out.length)
    throw new DecodeError(at, `a pose of ${length} numbers does not fit at ${offset} of ${out.length}`);
  if (layout.encoding === "weights") throw new DecodeError(at + 2, "weights are not a pose");
  const plain = layout.encoding === "f32" ? length : 3;
  for (let k = 0; k < plain; k++) {
    const value = view.getFloat32(start + 4 * k, true);
    if (!Number.isFinite(value)) throw new DecodeError(start + 4 * k, "a number of a pose is not finite");
    out[offset + k] = value;
  }
  if (layout.encoding === "q48")
    for (let j = 0; j < layout.joints; j++) readQ48(view, start + 12 + 6 * j, out, offset + 3 + 4 * j);
  if (layout.encoding === "q32")
    for (let j = 0; j < layout.joints; j++) readQ32(view.getUint32(start + 12 + 4 * j, true), out, offset + 3 + 4 * j);
}

/** Read the weights of the record at a byte offset, for `Evaluator.poseOf` at the head's phase. */
export function readWeights(view: DataView, at: number, layout: Layout): Float32Array {
  const start = at + RECORD_HEAD_BYTES;
  if (layout.encoding !== "weights") throw new DecodeError(at + 2, `${layout.encoding} has no weights`);
  const count = view.getUint16(start, true);
  if (RECORD_HEAD_BYTES + 4 + 4 * count > layout.recordBytes)
    throw new DecodeError(start, `${count} weights do not fit into ${layout.recordBytes} bytes`);
  const weights = Float32Array.from({ length: count }, (_, k) => view.getFloat32(start + 4 + 4 * k, true));
  if (!weights.every(Number.isFinite)) throw new DecodeError(start + 4, "a weight is not finite");
  return weights;
}

function readQ48(view: DataView, at: number, out: Float32Array, offset: number): void {
  const a = view.getUint16(at, true);
  const b = view.getUint16(at + 2, true);
  const c = view.getUint16(at + 4, true);
  const omitted = (a >> 15) | ((b >> 15) << 1);
  writeSmallestThree(omitted, a & 0x7fff, b & 0x7fff, c & 0x7fff, Q48_STEPS, out, offset);
}

function readQ32(word: number, out: Float32Array, offset: number): void {
  writeSmallestThree(word >>> 30, word & 0x3ff, (word >> 10) & 0x3ff, (word >> 20) & 0x3ff, Q32_STEPS, out, offset);
}

/** Write a rotation of its three smallest components, in steps; the largest is computed. */
function writeSmallestThree(
  missing: number,
  a: number,
  b: number,
  c: number,
  steps: number,
  out: Float32Array,
  offset: number,
): void {
  const unit = 1 / (steps * Math.SQRT2);
  const p = (a - steps) * unit;
  const q = (b - steps) * unit;
  const r = (c - steps) * unit;
  const left = Math.sqrt(Math.max(0, 1 - p * p - q * q - r * r));
  out[offset] = missing === 0 ? left : p;
  out[offset + 1] = missing === 1 ? left : missing < 1 ? p : q;
  out[offset + 2] = missing === 2 ? left : missing < 2 ? q : r;
  out[offset + 3] = missing === 3 ? left : r;
}

/** A goal: all adverbs of a channel, in the verb's order. */
export interface Goal {
  channel: number;
  adverbs: readonly number[];
}

/** Binary messages with the goals of several channels; each has one number of adverbs and at most 64 KiB. */
export function writeBulkAdverbs(goals: readonly Goal[]): ArrayBuffer[] {
  const messages: ArrayBuffer[] = [];
  const groups = new Map<number, Goal[]>();
  for (const goal of goals) {
    const group = groups.get(goal.adverbs.length);
    if (group) group.push(goal);
    else groups.set(goal.adverbs.length, [goal]);
  }
  for (const [count, group] of groups) {
    const row = 4 + 4 * count;
    const most = Math.floor((MOST_BYTES - 4) / row);
    for (let first = 0; first < group.length; first += most)
      messages.push(writeRows(group.slice(first, first + most), row));
  }
  return messages;
}

function writeRows(goals: readonly Goal[], row: number): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(4 + row * goals.length));
  view.setUint8(0, BULK_ADVERBS_OP);
  view.setUint16(2, goals.length, true);
  goals.forEach(({ channel, adverbs }, k) => {
    view.setUint16(4 + row * k, channel, true);
    adverbs.forEach((value, d) => {
      view.setFloat32(8 + row * k + 4 * d, value, true);
    });
  });
  return view.buffer;
}

/** Binary message that sets a channel's adverbs, in the verb's order. */
export function writeAdverbs(channel: number, adverbs: readonly number[]): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(4 + 4 * adverbs.length));
  view.setUint8(0, ADVERBS_OP);
  view.setUint16(2, channel, true);
  adverbs.forEach((value, k) => {
    view.setFloat32(4 + 4 * k, value, true);
  });
  return view.buffer;
}
