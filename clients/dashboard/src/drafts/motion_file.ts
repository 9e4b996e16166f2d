/** The answer of a draft's motion route: a JSON line, then float32 poses of each clip. */

import { DecodeError, poseLength } from "adverb-client";
import type { Skeleton } from "../types";
import type { ClipMotion, DraftMotion } from "./types";

const NEWLINE = 0x0a;
const LONGEST_HEADER = 4 * 1024 * 1024;

interface Header {
  readonly joints: number;
  readonly skeleton: Skeleton;
  readonly clips: readonly { name: string; samples: number; start: number; end: number }[];
}

export function readMotion(content: ArrayBuffer): DraftMotion {
  const bytes = new Uint8Array(content);
  const length = bytes.subarray(0, LONGEST_HEADER).indexOf(NEWLINE) + 1;
  if (length === 0 || length % 4 !== 0) throw new DecodeError(length, "the header is not a line of whole words");
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(0, length))) as Header;
  const size = poseLength(header.joints);
  let at = length;
  const clips = header.clips.map((clip): ClipMotion => {
    const count = clip.samples * size;
    if (clip.samples < 2 || at + 4 * count > content.byteLength)
      throw new DecodeError(at, `clip ${clip.name} needs ${4 * count} bytes`);
    const poses = new Float32Array(content, at, count);
    at += 4 * count;
    return { ...clip, poses };
  });
  return { skeleton: header.skeleton, clips };
}

/** Write the pose of a clip at a time to `out`: linear between samples, rotations normalized; clamped to its ends. */
export function poseAt(clip: ClipMotion, timeS: number, out: Float32Array): void {
  const size = out.length;
  const share = clip.end > clip.start ? (timeS - clip.start) / (clip.end - clip.start) : 0;
  const place = Math.min(Math.max(share, 0), 1) * (clip.samples - 1);
  const k = Math.min(Math.floor(place), clip.samples - 2);
  const t = place - k;
  const [a, b] = [k * size, (k + 1) * size];
  const { poses } = clip;
  for (let i = 0; i < 3; i++) out[i] = (1 - t) * (poses[a + i] as number) + t * (poses[b + i] as number);
  for (let i = 3; i < size; i += 4) {
    let dot = 0;
    for (let j = i; j < i + 4; j++) dot += (poses[a + j] as number) * (poses[b + j] as number);
    const far = dot < 0 ? -t : t;
    let square = 0;
    for (let j = i; j < i + 4; j++) {
      const value = (1 - t) * (poses[a + j] as number) + far * (poses[b + j] as number);
      out[j] = value;
      square += value * value;
    }
    const unit = 1 / Math.sqrt(square || 1);
    for (let j = i; j < i + 4; j++) out[j] = (out[j] as number) * unit;
  }
}
