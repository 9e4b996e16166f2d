/** Motion of a draft's verb at a goal: one sequence per goal and revision; at most one request runs. */

import { poseLength, Sequence } from "adverb-client";
import type { Draft, DraftRest } from "./types";

const FPS = 30;

export class Blend {
  #track: Sequence | null = null;
  #pose = new Float32Array(0);
  #wanted = "";
  #fetched = "";
  #next: { draft: Draft; goal: Readonly<Record<string, number>> } | null = null;
  #busy = false;
  /** Called when a new motion is there, or when there is none for the reason given. */
  onChange: (problem: string, revision: number) => void = () => {};

  constructor(private readonly rest: DraftRest) {}

  /** Request the motion of a saved draft at a goal; the last one stays until it arrives. */
  request(draft: Draft, goal: Readonly<Record<string, number>>): void {
    if (!draft.verb) {
      this.#track = null;
      this.#wanted = this.#fetched = "";
      this.#next = null;
      return this.onChange(draft.problem?.detail ?? "", draft.revision);
    }
    this.#wanted = JSON.stringify([draft.id, draft.revision, goal]);
    this.#next = { draft, goal };
    if (!this.#busy && this.#wanted !== this.#fetched) void this.#fetch();
  }

  /** Pose at a phase, and its record; null before the first answer. The array is reused. */
  at(phase: number): { poses: Float32Array; error: number; durationS: number } | null {
    if (!this.#track) return null;
    const { error, durationS } = this.#track.at(phase, this.#pose);
    return { poses: this.#pose, error, durationS };
  }

  async #fetch(): Promise<void> {
    const { draft, goal } = this.#next as { draft: Draft; goal: Readonly<Record<string, number>> };
    const key = this.#wanted;
    this.#busy = true;
    let problem = "";
    try {
      const joints = draft.verb?.skeleton.names.length ?? 0;
      const track = new Sequence(await this.rest.sequence(draft.id, goal, FPS), joints);
      if (this.#pose.length !== poseLength(joints)) this.#pose = new Float32Array(poseLength(joints));
      if (this.#wanted !== "") this.#track = track;
    } catch (err) {
      problem = err instanceof Error ? err.message : String(err);
    }
    this.#busy = false;
    this.#fetched = key;
    this.onChange(problem, draft.revision);
    if (this.#wanted !== "" && this.#wanted !== this.#fetched) void this.#fetch();
  }
}
