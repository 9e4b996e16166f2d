/** Limbs of a skeleton: what the element draws. */

import { type Rig, rigOf } from "../math/kinematics.js";
import type { Verb } from "../schema.js";

/** A limb from one point to another, or a ball where both are the same. */
export interface Limb {
  from: number;
  to: number;
  /** Radii at both ends, m. */
  start: number;
  end: number;
  /** Limbs of the right side are darker. */
  right: boolean;
}

/** Points are the joints, then the tips. */
export interface Body {
  rig: Rig;
  tips: readonly { parent: number; offset: readonly number[] }[];
  limbs: readonly Limb[];
  /** Height of the picture and of its middle, m. */
  height: number;
  middle: number;
}

/** Radii relative to the height: at the start and the end of the limb that ends at a joint. */
const THICKNESS: readonly (readonly [RegExp, number, number])[] = [
  [/thumb|finger|middle|index|ring|pinky/, 0.011, 0.008],
  [/toe/, 0.022, 0.017],
  [/foot|ankle/, 0.026, 0.022],
  [/leg$|shin|calf|knee/, 0.046, 0.031],
  [/upleg|thigh|hip/, 0.05, 0.05],
  [/hand|wrist/, 0.023, 0.017],
  [/forearm|elbow/, 0.03, 0.023],
  [/arm/, 0.03, 0.032],
  [/shoulder|clavicle/, 0.032, 0.034],
  [/head/, 0.028, 0.03],
  [/neck/, 0.062, 0.03],
  [/spine2|chest/, 0.062, 0.072],
  [/spine/, 0.058, 0.062],
];
const HEAD = 0.06;

export function bodyOf({ skeleton }: Verb): Body {
  const rig = rigOf(skeleton);
  const tips = skeleton.tips;
  const { height, middle } = frameOf(rig);
  const limbs: Limb[] = [];
  const limb = (from: number, to: number, name: string) => {
    const plain = name.toLowerCase();
    const [, start, end] = THICKNESS.find(([pattern]) => pattern.test(plain)) ?? [null, 0.025, 0.02];
    limbs.push({ from, to, start: start * height, end: end * height, right: plain.startsWith("r") });
  };
  skeleton.parents.forEach((parent, j) => {
    if (parent >= 0) limb(parent, j, skeleton.names[j] as string);
  });
  tips.forEach(({ parent }, k) => {
    const name = skeleton.names[parent] as string;
    const tip = rig.joints + k;
    if (/head/i.test(name))
      limbs.push({ from: parent, to: tip, start: 0.8 * HEAD * height, end: HEAD * height, right: false });
    else limb(parent, tip, name);
  });
  return { rig, tips, limbs, height, middle };
}

/** What the picture has to show: its height and the height of its middle, m. */
function frameOf({ joints, parents, offsets }: Rig): { height: number; middle: number } {
  const positions = new Float64Array(3 * joints);
  for (let k = 0; k < positions.length; k++) {
    const parent = parents[Math.floor(k / 3)] as number;
    positions[k] = (offsets[k] as number) + (parent < 0 ? 0 : (positions[3 * parent + (k % 3)] as number));
  }
  const extents = [0, 1, 2].map((a) => {
    const values = positions.filter((_, k) => k % 3 === a);
    return Math.max(...values) - Math.min(...values);
  });
  const [largest, upright] = [Math.max(...extents, 0.2), 1.1 * (extents[1] as number)];
  // without legs, the limbs may reach to all sides of the root
  return upright > 0.5 * largest ? { height: upright, middle: 0.52 * upright } : { height: 2 * largest, middle: 0 };
}
