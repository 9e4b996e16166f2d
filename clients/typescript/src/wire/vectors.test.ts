/** This client against the test vectors of the wire, tests/golden/wire_vectors.v1.json. */

import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { DecodeError } from "../errors.js";
import { JitterBuffer } from "../stream/buffer.js";
import { Clock, Lateness } from "../stream/clock.js";
import { viewMessage } from "./client_messages.js";
import {
  checkEnd,
  type Encoding,
  type Layout,
  layoutOf,
  MESSAGE_HEAD_BYTES,
  poseLength,
  readChannel,
  readMessageHead,
  readPose,
  readRecordHead,
  readWeights,
  writeAdverbs,
  writeBulkAdverbs,
} from "./decode.js";
import { readText } from "./server_messages.js";

type Rejection = "required" | "optional" | null;
type LayoutVector = { encoding: Encoding; joints: number; record_bytes: number };
type RecordVector = {
  offset: number;
  channel: number;
  encoding: Encoding;
  flags: number;
  version: number;
  phase: number;
  time: number;
  error: number | null;
  duration: number;
  root?: number[];
  weights?: number[];
  rotations?: number[][];
};
type MessageVector = { name: string; hex: string; layouts: Record<string, LayoutVector> };
type Vectors = {
  tolerances: { seconds: number };
  pose_messages: (MessageVector & {
    header: { records: number; sequence: number; time_ns: string; dropped: number };
    records: RecordVector[];
  })[];
  malformed_pose_messages: (MessageVector & { reason: string; rejection: Rejection })[];
  layouts: (LayoutVector & { rejection: Rejection })[];
  q48: {
    tolerance_rad: number;
    encode: { rotation: number[]; words: number[] }[];
    decode: { rotation: number[]; words: number[] }[];
  };
  q32: {
    tolerance_rad: number;
    encode: { rotation: number[]; word: number }[];
    decode: { rotation: number[]; word: number }[];
  };
  bulk_adverb_messages: { name: string; channels: number[]; adverbs: number[][]; hex: string }[];
  client_messages: { text: string; fields: Record<string, unknown> }[];
  adverb_messages: { channel: number; adverbs: number[]; hex: string }[];
  server_messages: { text: string; fields: Record<string, unknown> | null }[];
  malformed_server_messages: { text: string; reason: string }[];
  clocks: {
    name: string;
    pings: { sent_s: number; arrived_s: number; server_time_ns: string }[];
    offset_s: number;
    round_trip_s: number;
  }[];
  jitter: {
    name: string;
    interval_s: number;
    arrived_due_s: [number, number][];
    min_transit_s: number;
    lateness_s: number;
    delay_s: number;
  }[];
};

const FILE = new URL("../../../../tests/golden/wire_vectors.v1.json", import.meta.url);
const vectors = JSON.parse(readFileSync(FILE.pathname, "utf8")) as Vectors;
const toleranceMs = vectors.tolerances.seconds * 1000;

function viewOf(hex: string): DataView {
  return new DataView(Uint8Array.from(hex.match(/../g) ?? [], (pair) => Number.parseInt(pair, 16)).buffer);
}

function layoutsOf(vector: MessageVector): Map<number, Layout> {
  const rows = Object.entries(vector.layouts);
  return new Map(rows.map(([channel, row]) => [Number(channel), layoutOf(row.encoding, row.joints, row.record_bytes)]));
}

/** Reads a whole message: header, then the record header and the pose of each record. */
function readMessage(view: DataView, layouts: Map<number, Layout>) {
  const head = readMessageHead(view);
  const records = [];
  let at = MESSAGE_HEAD_BYTES;
  for (let k = 0; k < head.records; k++) {
    const layout = layouts.get(readChannel(view, at));
    if (!layout) throw new DecodeError(at, "a record of a channel that is not open");
    const record = readRecordHead(view, at, layout);
    const weights = layout.encoding === "weights";
    const pose = weights ? readWeights(view, at, layout) : new Float32Array(poseLength(layout.joints));
    if (!weights) readPose(view, at, layout, pose, 0);
    records.push({ at, record, pose });
    at += layout.recordBytes;
  }
  checkEnd(view, at);
  return { head, records };
}

/** The angle between two rotations, rad. */
function angle(a: readonly number[], b: readonly number[]): number {
  const chords = [1, -1].map((sign) => Math.hypot(...a.map((value, k) => value - sign * (b[k] as number))));
  return 4 * Math.asin(Math.min(...chords) / 2);
}

/** One rotation from q48 words. */
function unpack(words: readonly number[]): number[] {
  const layout = layoutOf("q48", 1, 44);
  const record = new DataView(new ArrayBuffer(44));
  record.setUint8(2, 1);
  words.forEach((word, k) => {
    record.setUint16(36 + 2 * k, word, true);
  });
  const out = new Float32Array(7);
  readPose(record, 0, layout, out, 0);
  return [...out.subarray(3)];
}

/** One rotation from a q32 word. */
function unpackWord(word: number): number[] {
  const record = new DataView(new ArrayBuffer(40));
  record.setUint8(2, 3);
  record.setUint32(36, word, true);
  const out = new Float32Array(7);
  readPose(record, 0, layoutOf("q32", 1, 40), out, 0);
  return [...out.subarray(3)];
}

function hexOf(message: ArrayBuffer | undefined): string {
  return [...new Uint8Array(message ?? new ArrayBuffer(0))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

test.each(vectors.pose_messages)("pose message: $name", (vector) => {
  const view = viewOf(vector.hex);
  const { head, records } = readMessage(view, layoutsOf(vector));
  const { sequence, dropped } = vector.header;
  expect(head).toMatchObject({ sequence, dropped, records: vector.header.records });
  const timeMs = Number(vector.header.time_ns) / 1e6;
  expect(Math.abs(head.timeMs - timeMs)).toBeLessThanOrEqual(Math.max(toleranceMs, timeMs * Number.EPSILON));
  vector.records.forEach((expected, k) => {
    const { at, record, pose } = records[k] as (typeof records)[number];
    expect(at).toBe(expected.offset);
    const { channel, flags, version, phase, time: timeS, duration: durationS } = expected;
    expect(record).toMatchObject({ channel, flags, version, phase, timeS, durationS });
    expect(Number.isNaN(record.error) ? null : record.error).toBe(expected.error);
    if (expected.weights) expect([...pose]).toEqual(expected.weights);
    if (!expected.root || !expected.rotations) return;
    expect([...pose.subarray(0, 3)]).toEqual(expected.root);
    expected.rotations.forEach((rotation, j) => {
      const found = [...pose.subarray(3 + 4 * j, 7 + 4 * j)];
      if (expected.encoding === "f32") expect(found).toEqual(rotation);
      else expect(angle(found, rotation)).toBeLessThan(vectors[expected.encoding as "q48" | "q32"].tolerance_rad);
    });
  });
});

test.each(vectors.malformed_pose_messages)("malformed pose message: $name", (vector) => {
  expect(() => readMessage(viewOf(vector.hex), layoutsOf(vector)), vector.reason).toThrow(DecodeError);
});

test.each(vectors.layouts.filter(({ rejection }) => rejection !== "optional"))(
  "layout of $joints joints as $encoding in $record_bytes bytes",
  ({ encoding, joints, record_bytes, rejection }) => {
    const read = () => layoutOf(encoding, joints, record_bytes);
    if (rejection === "required") expect(read).toThrow(DecodeError);
    else expect(read().recordBytes).toBe(record_bytes);
  },
);

test("q48 words are decoded", () => {
  for (const { words, rotation } of vectors.q48.encode)
    expect(angle(unpack(words), rotation), `${words}`).toBeLessThan(vectors.q48.tolerance_rad);
  for (const { words, rotation } of vectors.q48.decode)
    unpack(words).forEach((value, k) => {
      expect(value, `${words}`).toBeCloseTo(rotation[k] as number, 6);
    });
});

test("q32 words are decoded", () => {
  for (const { word, rotation } of vectors.q32.encode)
    expect(angle(unpackWord(word), rotation), `${word}`).toBeLessThan(vectors.q32.tolerance_rad);
  for (const { word, rotation } of vectors.q32.decode)
    unpackWord(word).forEach((value, k) => {
      expect(value, `${word}`).toBeCloseTo(rotation[k] as number, 6);
    });
});

test.each(vectors.bulk_adverb_messages)("adverbs of many channels: $name", ({ channels, adverbs, hex }) => {
  const messages = writeBulkAdverbs(channels.map((channel, k) => ({ channel, adverbs: adverbs[k] as number[] })));
  expect(messages.map(hexOf)).toEqual([hex]);
});

test("a message holds at most 64 KiB and one number of adverbs", () => {
  const goals = Array.from({ length: 5000 }, (_, channel) => ({ channel, adverbs: channel === 7 ? [1] : [1, 2, 3] }));
  const sizes = writeBulkAdverbs(goals).map((message) => message.byteLength);
  expect(sizes).toEqual([4 + 16 * 4095, 4 + 16 * 904, 4 + 8]);
});

test.each(vectors.client_messages.filter(({ fields }) => fields.op === "view"))("view: $text", ({ fields }) => {
  const { x, y, z, budget_kbps: budget } = fields as Record<string, number | undefined>;
  const position = x === undefined ? null : ([x, y, z] as [number, number, number]);
  expect(JSON.parse(viewMessage(position, budget ?? null))).toEqual(fields);
});

test.each(vectors.adverb_messages)("adverbs of channel $channel", ({ channel, adverbs, hex }) => {
  expect(hexOf(writeAdverbs(channel, adverbs))).toBe(hex);
});

test.each(vectors.server_messages)("server message: $text", ({ text, fields }) => {
  const message = readText(text) as unknown as Record<string, unknown>;
  for (const [name, value] of Object.entries(fields ?? {}))
    expect(message[name], name).toEqual(name === "server_time_ns" ? Number(value) : value);
});

test.each(vectors.malformed_server_messages)("malformed server message: $text", ({ text, reason }) => {
  expect(() => readText(text), reason).toThrow(DecodeError);
});

test.each(vectors.clocks)("clock: $name", ({ pings, offset_s, round_trip_s }) => {
  const clock = new Clock();
  for (const { sent_s, arrived_s, server_time_ns } of pings)
    clock.add(sent_s * 1000, arrived_s * 1000, Number(server_time_ns) / 1e6);
  expect(Math.abs(clock.offsetMs - offset_s * 1000)).toBeLessThan(toleranceMs);
  expect(Math.abs(clock.roundTripMs - round_trip_s * 1000)).toBeLessThan(toleranceMs);
});

test.each(vectors.jitter)("jitter: $name", (vector) => {
  const lateness = new Lateness();
  for (const [arrived, due] of vector.arrived_due_s) lateness.add(arrived * 1000, due * 1000);
  expect(Math.abs(lateness.groundMs - vector.min_transit_s * 1000)).toBeLessThan(toleranceMs);
  expect(Math.abs(lateness.beyondGroundMs(0.98) - vector.lateness_s * 1000)).toBeLessThan(toleranceMs);
  const buffer = new JitterBuffer(lateness);
  buffer.intervalMs = vector.interval_s * 1000;
  expect(Math.abs(buffer.delayMs - vector.delay_s * 1000)).toBeLessThan(toleranceMs);
});
