/** Positions of a draft's clips for the scene: joints of each clip at a phase, and paths of the effector. */

import { poseLength, rigOf, solve } from "adverb-client";
import type { ClipTime } from "./clip_time";
import { poseAt } from "./motion_file";
import type { ClipMotion, DraftMotion } from "./types";

/** Joint positions of clips, by forward kinematics. */
export class ClipFigures {
  readonly clips: ReadonlyMap<string, ClipMotion>;
  readonly joints: number;
  readonly #pose: Float32Array;
  readonly #rig;
  readonly #rotations: Float32Array;
  readonly #positions: Float32Array;

  constructor({ skeleton, clips }: DraftMotion) {
    this.#rig = rigOf(skeleton);
    this.joints = this.#rig.joints;
    this.clips = new Map(clips.map((clip) => [clip.name, clip]));
    this.#pose = new Float32Array(poseLength(this.#rig.joints));
    this.#rotations = new Float32Array(4 * this.joints);
    this.#positions = new Float32Array(3 * this.joints);
  }

  /** Pose of a clip at a time: root, then local rotations. The array is reused. */
  pose(clip: ClipMotion, timeS: number): Float32Array {
    poseAt(clip, timeS, this.#pose);
    return this.#pose;
  }

  /** Joint positions of a clip at a time, 3 per joint, m. The array is reused. */
  positions(clip: ClipMotion, timeS: number): Float32Array {
    solve(this.#rig, this.pose(clip, timeS), 0, this.#positions, this.#rotations);
    return this.#positions;
  }

  /** Positions of a joint from one time to another, 3 per point, m. */
  path(clip: ClipMotion, joint: number, from: number, to: number): Float32Array {
    const step = (clip.end - clip.start) / (clip.samples - 1);
    const count = Math.max(Math.ceil((to - from) / Math.max(step, 1e-6)), 1) + 1;
    const out = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) out.set(this.point(clip, joint, from + ((to - from) * k) / (count - 1)), 3 * k);
    return out;
  }

  /** Speed of a joint between the samples of a clip, m/s. */
  speeds(clip: ClipMotion, joint: number): number[] {
    const path = this.path(clip, joint, clip.start, clip.end);
    const step = (clip.end - clip.start) / Math.max(path.length / 3 - 1, 1);
    return Array.from({ length: path.length / 3 - 1 }, (_, k) => {
      const away = [0, 1, 2].map((i) => (path[3 * k + 3 + i] as number) - (path[3 * k + i] as number));
      return Math.hypot(...away) / Math.max(step, 1e-6);
    });
  }

  /** Position of a joint at a time, m; a view of a reused array. */
  point(clip: ClipMotion, joint: number, timeS: number): Float32Array {
    return this.positions(clip, timeS).subarray(3 * joint, 3 * joint + 3);
  }
}

/** A clip as the scene shows it. */
export interface ShownClip {
  readonly name: string;
  readonly keytimes: readonly number[];
  readonly time: ClipTime;
  readonly excluded: boolean;
  readonly selected: boolean;
}
