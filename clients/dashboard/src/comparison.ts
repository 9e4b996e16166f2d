/** Another version of the verb at the same goal and phase, fetched again when the goal changes. */

import { alignRoot, FLAGS, poseLength, Sequence } from "adverb-client";
import type { Picture, Rest, Shown, Verb, View } from "./types";
import { adverbValues } from "./verb";

const FPS = 60;

export class VersionComparison {
  private track: Sequence | null = null;
  private pose = new Float32Array(0);
  private targetKey = "";
  private fetched = "";
  private busy = false;

  constructor(
    private readonly rest: Rest,
    private readonly failed: (err: unknown) => void,
  ) {}

  /** Request the comparison of the current view. At most one request runs; only the newest goal follows it. */
  setTarget(view: View, verb: Verb | null): void {
    const { compare } = view;
    if (compare.kind !== "version" || !verb || adverbValues(verb, view.goal).length === 0) {
      this.targetKey = this.fetched = "";
      this.track = null;
      return;
    }
    const { goal, method } = view;
    this.targetKey = JSON.stringify({ verb: verb.name, compare, goal, method });
    if (!this.busy && this.targetKey !== this.fetched) void this.fetch(view, verb, compare.version);
  }

  /** The comparison's picture at the phase of the main figure, or null if there is none. */
  beside(shown: Shown, main: Float32Array, looping: boolean): { picture: Picture; shown: Shown } | null {
    if (!this.track) return null;
    const head = this.track.at(shown.phase, this.pose);
    if (looping) alignRoot(this.pose, main);
    const { version, timeS, durationS, error } = head;
    const root: Shown["root"] = [this.pose[0] as number, this.pose[1] as number, this.pose[2] as number];
    return {
      picture: { count: 1, poses: this.pose, error, phase: shown.phase },
      shown: {
        ...shown,
        version,
        timeS,
        durationS,
        error,
        root,
        count: 1,
        clamped: (head.flags & FLAGS.clamped) !== 0,
      },
    };
  }

  private async fetch(view: View, verb: Verb, version: number): Promise<void> {
    const key = this.targetKey;
    this.busy = true;
    try {
      const method = view.method ? { method: view.method } : {};
      const content = await this.rest.sequence(verb.name, { adverbs: { ...view.goal }, version, fps: FPS, ...method });
      const joints = verb.skeleton.names.length;
      const track = new Sequence(content, joints);
      if (this.targetKey === "") return;
      this.pose = new Float32Array(poseLength(joints));
      this.track = track;
    } catch (err) {
      this.track = null;
      this.failed(err);
    } finally {
      this.busy = false;
      this.fetched = key;
      this.onSettled?.();
    }
  }

  /** Called after a request ends, since the goal may have changed. */
  onSettled: (() => void) | null = null;
}
