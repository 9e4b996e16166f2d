import { Euler, Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import { DecodeError } from "./errors.js";
import { heading } from "./math/quaternion.js";
import { alignRoot, Sequence } from "./sequence.js";
import { poseLength } from "./wire/decode.js";

/** Frames of one joint, as the sequence route sends them. */
function records(phases: readonly number[]): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(52 * phases.length));
  phases.forEach((phase, k) => {
    const at = 52 * k;
    view.setUint32(at + 4, 9, true);
    [phase, 2 * phase, 0.25, 2, phase, 1, 0, 0, 0, Math.sin(phase / 2), Math.cos(phase / 2)].forEach((value, i) => {
      view.setFloat32(at + 8 + 4 * i, value, true);
    });
  });
  return view.buffer;
}

test("a sequence is interpolated between frames and clamped at its ends", () => {
  const track = new Sequence(records([0, 0.5, 1]), 1);
  const out = new Float32Array(poseLength(1));
  expect(track.version).toBe(9);
  for (const [phase, shown] of [
    [0, 0],
    [0.25, 0.25],
    [0.9, 0.9],
    [1, 1],
    [-1, 0],
    [2, 1],
  ] as const) {
    const head = track.at(phase, out);
    expect(out[0]).toBeCloseTo(shown, 5);
    expect(2 * Math.atan2(out[5] as number, out[6] as number)).toBeCloseTo(shown, 5);
    expect([head.error, head.version]).toEqual([0.25, 9]);
    expect(head.timeS).toBeCloseTo(2 * shown, 5);
  }
});

test("an incomplete sequence is rejected", () => {
  for (const content of [new ArrayBuffer(0), records([0, 1]).slice(0, 60)])
    expect(() => new Sequence(content, 1)).toThrow(DecodeError);
});

test("alignRoot copies ground position and heading, and keeps height and tilt", () => {
  const pose = (x: number, y: number, z: number, turn: number, tilt: number) =>
    new Float32Array([x, y, z, ...new Quaternion().setFromEuler(new Euler(tilt, turn, 0, "YXZ")).toArray()]);
  const mine = pose(1, 0.9, 2, 0.3, 0.2);
  alignRoot(mine, pose(-4, 1, 7, 2, -0.1));
  expect([...mine.subarray(0, 3)]).toEqual([-4, new Float32Array([0.9])[0], 7]);
  expect(heading(mine, 3)).toBeCloseTo(2, 5);
  const up = new Vector3(0, 1, 0).applyQuaternion(new Quaternion().fromArray(mine, 3));
  expect(up.y).toBeCloseTo(Math.cos(0.2), 5);
});
