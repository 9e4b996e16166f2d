import { expect, test } from "vitest";
import { poseAt, readMotion } from "./motion_file";

/** A file of clips with one joint: root x is the sample's number, and the joint turns about +Y by 90° per sample. */
function file(clips: { name: string; samples: number }[]): ArrayBuffer {
  const skeleton = { names: ["root"], parents: [-1], offsets: [[0, 0, 0]], tips: [] };
  const header = JSON.stringify({ joints: 1, skeleton, clips: clips.map((clip) => ({ ...clip, start: 1, end: 2 })) });
  const line = `${header}${" ".repeat(3 - (header.length % 4))}\n`;
  const numbers = clips.flatMap(({ samples }) =>
    Array.from({ length: samples }, (_, k) => [
      k,
      0,
      0,
      0,
      Math.sin((k * Math.PI) / 4),
      0,
      Math.cos((k * Math.PI) / 4),
    ]),
  );
  const bytes = new Uint8Array(line.length + 28 * numbers.length);
  bytes.set(new TextEncoder().encode(line));
  bytes.set(new Uint8Array(Float32Array.from(numbers.flat()).buffer), line.length);
  return bytes.buffer;
}

test("clips are read in order, and sampled between their poses", () => {
  const { clips, skeleton } = readMotion(
    file([
      { name: "a", samples: 2 },
      { name: "b", samples: 3 },
    ]),
  );
  expect(skeleton.names).toEqual(["root"]);
  expect(clips.map(({ name, poses }) => [name, poses.length])).toEqual([
    ["a", 14],
    ["b", 21],
  ]);
  const pose = new Float32Array(7);
  poseAt(clips[1] as (typeof clips)[0], 1.25, pose);
  expect(pose[0]).toBeCloseTo(0.5, 6);
  expect(pose[4]).toBeCloseTo(Math.sin(Math.PI / 8), 6);
  expect(pose[6]).toBeCloseTo(Math.cos(Math.PI / 8), 6);
  poseAt(clips[1] as (typeof clips)[0], 9, pose);
  expect(pose[0]).toBe(2);
});

test("a file that ends early is an error that names the clip", () => {
  const whole = file([{ name: "a", samples: 2 }]);
  expect(() => readMotion(whole.slice(0, whole.byteLength - 4))).toThrow(/clip a needs 56 bytes/);
  expect(() => readMotion(new ArrayBuffer(16))).toThrow(/header/);
});
