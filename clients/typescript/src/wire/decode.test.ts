import { readFileSync } from "node:fs";
import fc from "fast-check";
import { Quaternion } from "three";
import { expect, test } from "vitest";
import { DecodeError } from "../errors.js";
import {
  type Encoding,
  type Layout,
  layoutOf,
  MESSAGE_HEAD_BYTES,
  poseLength,
  readChannel,
  readMessageHead,
  readPose,
  readRecordHead,
  writeAdverbs,
} from "./decode.js";

const GOLDEN = new URL("../../../../tests/golden/pose_message.v1", import.meta.url);
const bytes = readFileSync(`${GOLDEN.pathname}.bin`);
const golden = JSON.parse(readFileSync(`${GOLDEN.pathname}.json`, "utf8")) as {
  sequence: number;
  time_ns: string;
  dropped: number;
  records: {
    at: number;
    bytes: number;
    channel: number;
    encoding: Encoding;
    flags: number;
    version: number;
    phase: number;
    time: number;
    error: number | null;
    duration: number;
    root?: number[];
    rotations?: number[][];
    joints?: number;
  }[];
};
const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
const layouts = golden.records.map((record) => layoutOf(record.encoding, record.joints ?? 0, record.bytes));

/** Angle between two nearly equal rotations, rad; accurate where an arc cosine is not. */
function apart(a: readonly number[], b: readonly number[]): number {
  const lengths = [1, -1].map((sign) => Math.hypot(...a.map((value, k) => value - sign * (b[k] as number))));
  return 2 * Math.min(...lengths);
}

test("the golden message decodes to its JSON description", () => {
  const head = readMessageHead(view);
  expect(head).toMatchObject({ sequence: golden.sequence, dropped: golden.dropped, records: golden.records.length });
  expect(head.timeMs).toBeCloseTo(Number(golden.time_ns) / 1e6, 3);
  golden.records.forEach((record, k) => {
    const layout = layouts[k] as Layout;
    const { channel, flags, version, phase, time: timeS, duration: durationS } = record;
    expect(readChannel(view, record.at)).toBe(channel);
    const read = readRecordHead(view, record.at, layout);
    expect(read).toMatchObject({ channel, flags, version, phase, timeS, durationS });
    expect(Number.isNaN(read.error) ? null : read.error).toBe(record.error);
    if (!record.root || !record.rotations) return;
    const out = new Float32Array(poseLength(layout.joints) + 2).fill(7);
    readPose(view, record.at, layout, out, 1);
    expect([...out.subarray(1, 4)]).toEqual(record.root);
    record.rotations.forEach((expected, j) => {
      const read = [...out.subarray(4 + 4 * j, 8 + 4 * j)];
      expect(apart(read, expected)).toBeLessThan(record.encoding === "q48" ? 0.00015 : 1e-6);
    });
    expect([out[0], out.at(-1)]).toEqual([7, 7]);
  });
});

/** Smallest-three encoder of docs/wire.md. */
function pack(q: readonly number[]): number[] {
  const largest = q.reduce((best, value, k) => (Math.abs(value) > Math.abs(q[best] as number) ? k : best), 0);
  const sign = (q[largest] as number) < 0 ? -1 : 1;
  const words = q
    .filter((_, k) => k !== largest)
    .map((value) => Math.round(16383 * Math.SQRT2 * sign * value) + 16383) as [number, number, number];
  return [words[0] | ((largest & 1) << 15), words[1] | ((largest >> 1) << 15), words[2]];
}

test("every rotation comes back from q48 within 0.00015 rad", () => {
  const part = fc.double({ min: -1, max: 1, noNaN: true });
  const layout = layoutOf("q48", 1, 44);
  fc.assert(
    fc.property(fc.tuple(part, part, part, part), (parts) => {
      fc.pre(Math.hypot(...parts) > 1e-3);
      const q = new Quaternion(...parts).normalize();
      const record = new DataView(new ArrayBuffer(44));
      record.setUint8(2, 1);
      pack(q.toArray()).forEach((word, k) => {
        record.setUint16(36 + 2 * k, word, true);
      });
      const out = new Float32Array(7);
      readPose(record, 0, layout, out, 0);
      expect(apart([...out.subarray(3)], q.toArray())).toBeLessThan(0.00015);
    }),
    { numRuns: 500 },
  );
});

test("a message truncated at any byte is an error", () => {
  for (let length = 0; length < bytes.byteLength; length++) {
    const cut = new DataView(bytes.buffer, bytes.byteOffset, length);
    const read = () => {
      const { records } = readMessageHead(cut);
      let at = MESSAGE_HEAD_BYTES;
      for (let k = 0; k < records; k++) {
        readChannel(cut, at);
        readRecordHead(cut, at, layouts[k] as Layout);
        at += (layouts[k] as Layout).recordBytes;
      }
    };
    expect(read, `${length} bytes`).toThrow(DecodeError);
  }
});

test("invalid records are rejected with the byte offset", () => {
  const other = new DataView(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength));
  const layout = layouts[0] as Layout;
  expect(() => readRecordHead(other, 20, { ...layout, encoding: "q48" })).toThrow(/byte 22: encoding 0 where q48/);
  expect(() => readPose(other, 20, layout, new Float32Array(4), 0)).toThrow(/does not fit/);
  other.setFloat32(28, Number.NaN, true);
  expect(() => readRecordHead(other, 20, layout)).toThrow(/not finite/);
  other.setUint8(1, 9);
  expect(() => readMessageHead(other)).toThrow(/wire version 9/);
  other.setUint8(0, 2);
  expect(() => readMessageHead(other)).toThrow(/op 2/);
  expect(() => layoutOf("f32", 22, 100)).toThrow(DecodeError);
});

test("adverbs are encoded as documented", () => {
  const out = new DataView(writeAdverbs(513, [0.5, -2]));
  expect([out.getUint8(0), out.getUint8(1), out.getUint16(2, true)]).toEqual([0x10, 0, 513]);
  expect([out.getFloat32(4, true), out.getFloat32(8, true), out.byteLength]).toEqual([0.5, -2, 12]);
});
