/** Ground of a looping verb whose cycle climbs: its gradient, and the height of the root above it. */

import { heading, poseLength, rigOf, Sequence, solve } from "adverb-client";
import { extremeExamples, jointPoints, tipPoints } from "./motion_extent";
import { sub, type V3 } from "./scene/vec";
import type { Incline, Rest, Skeleton, Verb } from "./types";

/** Samples of a cycle; the last is the first of the next cycle. */
const SAMPLES = 49;
const FPS = 30;
/** Smaller gradients than this are level ground, m/m. */
const LEVEL = 0.02;
/** Cycles that travel less give no gradient, m. */
const SHORTEST_M = 0.02;
const WHOLE_TURN = 2 * Math.PI;
const INTERVAL_MS = 120;

type Adverbs = Readonly<Record<string, number>>;

/** Keeps the incline of the selected verb at its goal; level for verbs of which no extreme example climbs. */
export class Inclines {
  private verb: Verb | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private requests = 0;

  /** @param show called with every incline of a verb that climbs */
  constructor(
    private readonly rest: Rest,
    private readonly show: (incline: Incline) => void,
  ) {}

  async select(verb: Verb, goal: Adverbs): Promise<void> {
    this.verb = null;
    clearTimeout(this.timer);
    const request = ++this.requests;
    if (!verb.looping) return;
    const extreme = await Promise.all(extremeExamples(verb).map((adverbs) => this.request(verb, adverbs)));
    if (request !== this.requests || !extreme.some(({ gradient }) => Math.abs(gradient) > LEVEL)) return;
    this.verb = verb;
    await this.load(goal);
  }

  /** The goal changed; requests of a moving goal are limited to one per interval. */
  move(goal: Adverbs): void {
    clearTimeout(this.timer);
    if (this.verb) this.timer = setTimeout(() => void this.load(goal).catch(() => {}), INTERVAL_MS);
  }

  private async load(goal: Adverbs): Promise<void> {
    if (!this.verb || Object.keys(goal).length === 0) return; // the server chooses the first goal; it moves then
    const request = ++this.requests;
    const incline = await this.request(this.verb, goal);
    if (request === this.requests) this.show(incline);
  }

  private async request(verb: Verb, adverbs: Adverbs): Promise<Incline> {
    const content = await this.rest.sequence(verb.name, { adverbs: { ...adverbs }, fps: FPS });
    return inclineOf(new Sequence(content, verb.skeleton.names.length), verb.skeleton);
  }
}

/** Incline of one cycle: the ground rises as the root does, and the lowest point of the body touches it. */
export function inclineOf(sequence: Sequence, skeleton: Skeleton): Incline {
  const cycle = cycleOf(sequence, skeleton);
  const [first, last] = [cycle[0] as Sample, cycle[SAMPLES - 1] as Sample];
  const [dx, dy, dz] = sub(last.root, first.root);
  const travel = Math.hypot(dx, dz);
  const gradient = travel > SHORTEST_M ? dy / travel : 0;
  const course = travel > SHORTEST_M ? Math.atan2(dx, dz) : first.yaw;
  const above = ([x, y, z]: V3) => y - gradient * (x * Math.sin(course) + z * Math.cos(course));
  const lowest = Math.min(...cycle.flatMap(({ points }) => points.map(above)));
  return {
    gradient,
    heights: Float32Array.from(cycle, ({ root }) => above(root) - lowest),
    turns: Float32Array.from(cycle, ({ yaw }) => course - yaw),
  };
}

interface Sample {
  readonly root: V3;
  readonly yaw: number;
  /** Joints and ends of the skeleton, m. */
  readonly points: readonly V3[];
}

function cycleOf(sequence: Sequence, skeleton: Skeleton): Sample[] {
  const rig = rigOf(skeleton);
  const [positions, rotations] = [new Float32Array(3 * rig.joints), new Float32Array(4 * rig.joints)];
  const pose = new Float32Array(poseLength(rig.joints));
  let yaw = 0;
  return Array.from({ length: SAMPLES }, (_, k) => {
    sequence.at(k / (SAMPLES - 1), pose);
    solve(rig, pose, 0, positions, rotations);
    const away = heading(rotations, 0) - yaw;
    yaw += away - WHOLE_TURN * Math.round(away / WHOLE_TURN); // continuous
    const points = [...jointPoints(positions), ...tipPoints(skeleton, positions, rotations)];
    return { points, root: points[0] as V3, yaw };
  });
}
