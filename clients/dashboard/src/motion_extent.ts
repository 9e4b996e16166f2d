/** Extent of a verb's motion: extreme joint positions over the motions of its extreme examples. */

import { poseLength, rigOf, rotate, Sequence, solve } from "adverb-client";
import type { V3 } from "./scene/vec";
import type { Rest, Skeleton, Verb } from "./types";

const FPS = 15;
const PHASES = 13;
/** Directions of the 26 neighbours of a cube. */
const DIRECTIONS = [-1, 0, 1].flatMap((x) =>
  [-1, 0, 1].flatMap((y) => [-1, 0, 1].map((z): V3 => [x, y, z]).filter((d) => d.some((value) => value !== 0))),
);

/**
 * Extreme positions, m: relative to the root's ground position for looping verbs, else to the verb's origin.
 * Requests one sequence for the lowest and the highest example of each adverb.
 */
export async function motionExtent(rest: Rest, verb: Verb): Promise<V3[]> {
  const sequences = extremeExamples(verb).map(async (adverbs) => {
    const content = await rest.sequence(verb.name, { adverbs: { ...adverbs }, fps: FPS });
    return positionsOf(new Sequence(content, verb.skeleton.names.length), verb);
  });
  return extremePoints((await Promise.all(sequences)).flat());
}

/** Adverbs of the examples that are lowest or highest in one adverb. */
export function extremeExamples({ adverbs, examples }: Verb): Readonly<Record<string, number>>[] {
  const value = (k: number, name: string) => examples[k]?.adverbs[name] ?? 0;
  const chosen = adverbs.flatMap(({ name }) => {
    const order = examples.map((_, k) => k).sort((a, b) => value(a, name) - value(b, name));
    return [order[0], order.at(-1)];
  });
  return [...new Set(chosen)].flatMap((k) => {
    const example = k === undefined ? undefined : examples[k];
    return example ? [example.adverbs] : [];
  });
}

function positionsOf(sequence: Sequence, { skeleton, looping }: Verb): V3[] {
  const rig = rigOf(skeleton);
  const [positions, rotations] = [new Float32Array(3 * rig.joints), new Float32Array(4 * rig.joints)];
  const pose = new Float32Array(poseLength(rig.joints));
  return Array.from({ length: PHASES }, (_, k) => {
    sequence.at(k / (PHASES - 1), pose);
    if (looping) pose[0] = pose[2] = 0;
    solve(rig, pose, 0, positions, rotations);
    return [...jointPoints(positions), ...tipPoints(skeleton, positions, rotations)];
  }).flat();
}

/** Positions of joints as points, m. */
export function jointPoints(positions: Float32Array): V3[] {
  return Array.from({ length: positions.length / 3 }, (_, j) => [...positions.subarray(3 * j, 3 * j + 3)] as never);
}

/** Positions of the ends of a skeleton, m. */
export function tipPoints({ tips }: Skeleton, positions: Float32Array, rotations: Float32Array): V3[] {
  return tips.map(({ parent, offset }) => {
    const out = [0, 0, 0];
    rotate(out, 0, rotations, 4 * parent, offset, 0);
    return out.map((value, k) => value + (positions[3 * parent + k] as number)) as never;
  });
}

/** The farthest point in each of 26 directions. */
export function extremePoints(points: readonly V3[]): V3[] {
  const along = (p: V3, [x, y, z]: V3) => p[0] * x + p[1] * y + p[2] * z;
  if (points.length === 0) return [];
  const farthest = DIRECTIONS.map((d) => points.reduce((best, p) => (along(p, d) > along(best, d) ? p : best)));
  return [...new Set(farthest)];
}
