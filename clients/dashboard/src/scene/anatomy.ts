import type { Skeleton } from "../types";
import { add, cross, length, mean, scale, square, sub, unit, type V3, ZERO } from "./vec";

/** Body part that starts at a joint. */
export type Region =
  | "hips"
  | "spine"
  | "neck"
  | "head"
  | "clavicle"
  | "upperArm"
  | "forearm"
  | "hand"
  | "finger"
  | "thigh"
  | "shin"
  | "foot"
  | "toe"
  | "other";

/** Skeleton in its rest pose: regions, children, positions and body axes. */
export interface Anatomy {
  readonly regions: readonly Region[];
  readonly children: readonly (readonly number[])[];
  /** Rest positions relative to the root, m. */
  readonly positions: readonly V3[];
  /** End offsets per joint (crown, fingertips, toes), in the joint's frame. */
  readonly tips: readonly (readonly V3[])[];
  readonly parents: readonly number[];
  readonly offsets: readonly V3[];
  /** Unit axes of the body at rest. */
  readonly up: V3;
  readonly left: V3;
  readonly forward: V3;
}

/** The first match decides; specific patterns come first. */
const NAMES: readonly (readonly [RegExp, Region])[] = [
  [/thumb|index|middle|ring|pinky|finger|metacarp/, "finger"],
  [/toe|^(left|right|l|r)?ball/, "toe"],
  [/foot|ankle/, "foot"],
  [/upleg|upperleg|thigh|^(left|right|l|r)hip$/, "thigh"],
  [/leg$|lowleg|lowerleg|shin|calf|knee/, "shin"],
  [/forearm|lowerarm|lowarm|elbow/, "forearm"],
  [/shoulder|clavicle|collar/, "clavicle"],
  [/arm/, "upperArm"],
  [/hand|wrist/, "hand"],
  [/head|skull/, "head"],
  [/neck/, "neck"],
  [/hips|pelvis/, "hips"],
  [/spine|chest|torso|waist|abdomen/, "spine"],
];

function guess(name: string): Region {
  const plain = name.slice(name.lastIndexOf(":") + 1).toLowerCase();
  const letters = plain.replace(/[^a-z]/g, "");
  return NAMES.find(([pattern]) => pattern.test(letters))?.[1] ?? "other";
}

/** Classify by name; a shoulder with a forearm as child is an upper arm. */
function regionsOf(names: readonly string[], children: readonly (readonly number[])[]): Region[] {
  const regions = names.map(guess);
  return regions.map((region, j) => {
    const carries = (what: Region) => children[j]?.some((child) => regions[child] === what);
    return region === "clavicle" && carries("forearm") ? "upperArm" : region;
  });
}

function axesOf(regions: readonly Region[], positions: readonly V3[]): Pick<Anatomy, "up" | "left" | "forward"> {
  const of = (region: Region) => positions.filter((_, j) => regions[j] === region);
  const [hips, top] = [of("thigh"), [...of("upperArm"), ...of("neck")]];
  const up = hips.length && top.length ? unit(sub(mean(top), mean(hips))) : ([0, 1, 0] as V3);
  const pair = of("upperArm").length === 2 ? of("upperArm") : hips;
  const across = pair.length === 2 ? sub(pair[0] as V3, pair[1] as V3) : ([1, 0, 0] as V3);
  const left = square(across[0] < 0 ? scale(across, -1) : across, up);
  return { up, left, forward: cross(left, up) };
}

export function anatomyOf(skeleton: Skeleton): Anatomy {
  const offsets = skeleton.offsets as unknown as readonly V3[];
  const { parents, names } = skeleton;
  const children = names.map((_, j) => parents.flatMap((parent, child) => (parent === j ? [child] : [])));
  const tips = names.map((_, j) => skeleton.tips.filter((t) => t.parent === j).map((t) => t.offset as unknown as V3));
  const positions: V3[] = [];
  for (const [j, parent] of parents.entries()) {
    positions.push(parent < 0 ? ZERO : add(positions[parent] as V3, offsets[j] as V3));
  }
  const regions = regionsOf(names, children);
  return { regions, children, positions, tips, parents, offsets, ...axesOf(regions, positions) };
}

/** Whether two legs, two arms and a head are found by name. */
export function isHuman(anatomy: Anatomy): boolean {
  const count = (region: Region) => anatomy.regions.filter((r) => r === region).length;
  const pairs: readonly Region[] = ["thigh", "shin", "foot", "upperArm", "forearm"];
  return pairs.every((region) => count(region) === 2) && count("head") === 1;
}

/** Whether the skeleton is a single chain without branches. */
export function isChain(anatomy: Anatomy): boolean {
  return anatomy.children.length > 1 && anatomy.children.every((children) => children.length <= 1);
}

/** End points of a joint's segments in the joint's frame: children first, then tips; zero lengths are skipped. */
export function ends(anatomy: Anatomy, j: number): readonly V3[] {
  const children = (anatomy.children[j] ?? []).map((child) => anatomy.offsets[child] as V3);
  return [...children, ...(anatomy.tips[j] ?? [])].filter((end) => length(end) > 1e-4);
}

/** Total segment length below each joint, m. */
export function hangingLength(anatomy: Anatomy): readonly number[] {
  const reach = anatomy.positions.map(() => 0);
  for (let j = reach.length - 1; j >= 0; j--) {
    reach[j] = (reach[j] as number) + (anatomy.tips[j] ?? []).reduce((sum, tip) => sum + length(tip), 0);
    const parent = anatomy.parents[j] as number;
    if (parent >= 0)
      reach[parent] = (reach[parent] as number) + (reach[j] as number) + length(anatomy.offsets[j] as V3);
  }
  return reach;
}
