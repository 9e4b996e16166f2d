/** Another version of the verb at the same goal and phase: its motion is fetched whenever the goal has moved. */

import type { Picture, Rest, Shown, Verb, View } from "./types";
import { inOrder } from "./verb";
import { FLAGS, poseLength } from "./wire/decode";
import { standAs, Track } from "./wire/sequence";

const FPS = 60;

export class OtherVersion {
  private track: Track | null = null;
  private pose = new Float32Array(0);
  private wanted = "";
  private fetched = "";
  private busy = false;

  constructor(
    private readonly rest: Rest,
    private readonly failed: (err: unknown) => void,
  ) {}

  /** The view or the verb changed. Calls that are overtaken by a newer goal are not made. */
  want(view: View, verb: Verb | null): void {
    const { against } = view;
    if (against.kind !== "version" || !verb || inOrder(verb, view.goal).length === 0) {
      this.wanted = this.fetched = "";
      this.track = null;
      return;
    }
    const { goal, method } = view;
    this.wanted = JSON.stringify({ verb: verb.name, against, goal, method });
    if (!this.busy && this.wanted !== this.fetched) void this.fetch(view, verb, against.version);
  }

  /** The picture beside one of the steered figure, or null where none is wanted or there yet. */
  beside(shown: Shown, main: Float32Array, looping: boolean): { picture: Picture; shown: Shown } | null {
    if (!this.track) return null;
    const head = this.track.at(shown.phase, this.pose);
    if (looping) standAs(this.pose, main);
    const { version, timeS: time_s, durationS: duration_s, error } = head;
    const root: Shown["root"] = [this.pose[0] as number, this.pose[1] as number, this.pose[2] as number];
    return {
      picture: { count: 1, poses: this.pose, error, phase: shown.phase },
      shown: {
        ...shown,
        version,
        time_s,
        duration_s,
        error,
        root,
        count: 1,
        clamped: (head.flags & FLAGS.clamped) !== 0,
      },
    };
  }

  private async fetch(view: View, verb: Verb, version: number): Promise<void> {
    const asked = this.wanted;
    this.busy = true;
    try {
      const method = view.method ? { method: view.method } : {};
      const content = await this.rest.sequence(verb.name, { adverbs: { ...view.goal }, version, fps: FPS, ...method });
      const joints = verb.skeleton.names.length;
      const track = new Track(content, joints);
      if (this.wanted === "") return;
      this.pose = new Float32Array(poseLength(joints));
      this.track = track;
    } catch (err) {
      this.track = null;
      this.failed(err);
    } finally {
      this.busy = false;
      this.fetched = asked;
      this.again?.();
    }
  }

  /** Called when an answer has come: the goal may have moved on. */
  again: (() => void) | null = null;
}
