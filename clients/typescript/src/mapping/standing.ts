/** A skeleton that stands: its rest pose, its bones, and how another one turns to stand as it does. */

import { type Roles, rolesOf } from "./names.js";
import {
  add,
  arc,
  cross,
  dot,
  inverse,
  length,
  level,
  multiply,
  ofAxes,
  type Q,
  rotate,
  STILL,
  sub,
  times,
  unit,
  type V,
} from "./vector.js";

/** Joint at rest, relative to its parent; parents come first, lengths are metres. */
export interface RestJoint {
  name: string;
  /** -1: none. */
  parent: number;
  rotation: Q;
  position: V;
}

/** A body whose up, and whose side, is within these angles of an axis has that axis, radians. */
const UP_RAD = 0.35;
const SIDE_RAD = 0.1;
/** Least score of a pose that stands. */
const STANDS = 0.8;

export class Standing {
  readonly roles: Roles;
  readonly names: readonly string[];
  readonly parents: readonly number[];
  /** Global. */
  readonly rotations: Q[] = [];
  readonly positions: V[] = [];
  /** From our axes to those of the body. */
  readonly frame: Q;
  readonly up: V;

  constructor(
    readonly joints: readonly RestJoint[],
    given: Readonly<Record<string, number>> = {},
    readonly ground: number | null = null,
  ) {
    this.names = joints.map(({ name }) => name);
    this.parents = joints.map(({ parent }) => parent);
    for (const { parent, rotation, position } of joints) {
      const above = this.rotations[parent] ?? STILL;
      this.rotations.push(multiply(above, rotation));
      this.positions.push(add(this.positions[parent] ?? [0, 0, 0], rotate(above, position)));
    }
    this.roles = rolesOf(this.names, this.parents, given);
    this.frame = this.body();
    this.up = rotate(this.frame, [0, 1, 0]);
  }

  /** Place of a bone at rest; undefined without it. */
  at(bone: string): V | undefined {
    return this.positions[this.roles.bones[bone] ?? -1];
  }

  /** Height of the ground along the up, `sole` below the lowest joint where the file does not say. */
  floor(sole = 0): number {
    return this.ground ?? Math.min(...this.positions.map((place) => dot(place, this.up))) - sole;
  }

  /** Length of the legs from hip to ground along the bones; 1 without legs. */
  legs(sole = 0): number {
    const found = ["left", "right"].flatMap((side) => {
      const [hip, knee, ankle] = ["UpperLeg", "LowerLeg", "Foot"].map((part) => this.at(side + part));
      if (!hip || !knee || !ankle) return [];
      const above = Math.max(dot(ankle, this.up) - this.floor(sole), 0);
      return [length(sub(hip, knee)) + length(sub(knee, ankle)) + above];
    });
    return found.length > 0 ? found.reduce((a, b) => a + b) / found.length : 1;
  }

  /** Whether legs are straight and down and arms straight and not raised; true for what is no humanoid. */
  get stands(): boolean {
    const [leftArm, rightArm] = [this.at("leftUpperArm"), this.at("rightUpperArm")];
    const [leftLeg, rightLeg] = [this.at("leftUpperLeg"), this.at("rightUpperLeg")];
    if (!leftArm || !rightArm || !leftLeg || !rightLeg) return true;
    const up = unit(sub(add(leftArm, rightArm), add(leftLeg, rightLeg)));
    return ["left", "right"].every((side) => {
      const along = (a: string, b: string) => {
        const [from, to] = [this.at(side + a), this.at(side + b)];
        return from && to ? unit(sub(to, from)) : null;
      };
      const legs = [along("UpperLeg", "LowerLeg"), along("LowerLeg", "Foot")];
      const [upper, lower] = [along("UpperArm", "LowerArm"), along("LowerArm", "Hand")];
      const isDown = legs.every((leg) => !leg || -dot(leg, up) >= STANDS);
      return isDown && (!upper || !lower || dot(upper, lower) - Math.max(dot(upper, up), 0) >= STANDS);
    });
  }

  private body(): Q {
    const pair = (part: string) => [this.at(`left${part}`), this.at(`right${part}`)] as const;
    const pairs = ["UpperLeg", "UpperArm", "Shoulder", "Hand"].map(pair).flatMap(([l, r]) => (l && r ? [[l, r]] : []));
    const [first] = pairs as [V, V][];
    if (!first || this.roles.bones.hips === undefined) return STILL;
    const middle = ([a, b]: readonly [V, V]) => times(add(a, b), 0.5);
    const [left, right] = pair("Foot");
    const low = left && right ? middle([left, right]) : middle(first);
    const high = this.at("head") ?? middle(pairs.at(-1) as [V, V]);
    const side = (pairs as [V, V][]).slice(0, 2).reduce<V>((sum, [l, r]) => add(sum, sub(l, r)), [0, 0, 0]);
    const up = snapped(sub(high, low), UP_RAD);
    const lateral = unit(level(snapped(level(side, up), SIDE_RAD), up));
    return ofAxes(lateral, up, cross(lateral, up));
  }
}

function snapped(vector: V, within: number): V {
  const own = unit(vector);
  const axis = own.findIndex((value) => Math.abs(value) === Math.max(...own.map(Math.abs)));
  const near = [0, 1, 2].map((k) => (k === axis ? Math.sign(own[axis] ?? 0) : 0)) as unknown as V;
  return dot(own, near) > Math.cos(within) ? near : own;
}

/** How one target joint moves: between two joints of the source. */
export interface Row {
  target: number;
  first: number;
  second: number;
  share: number;
  bone: string;
  given: boolean;
}

/** Rows of the target joints that move, in their order; see docs/mapping.md. */
export function plan(source: Standing, target: Standing, joints: Readonly<Record<string, string>> = {}): Row[] {
  const rows = new Map<number, Row>();
  const put = (at: number, first: number, bone: string, given = false) =>
    rows.set(at, { target: at, first, second: first, share: 0, bone, given });
  const [own, other] = [source.roles, target.roles];
  if (own.bones.hips !== undefined && other.bones.hips !== undefined) {
    for (const [bone, joint] of Object.entries(own.bones))
      if (bone in other.bones) put(other.bones[bone] as number, joint, bone);
    for (const side of ["left", "right"])
      for (const finger of ["Index", "Ring", "Little"])
        for (const part of ["Proximal", "Intermediate", "Distal"]) {
          const [joint, at] = [own.bones[`${side}Middle${part}`], other.bones[side + finger + part]];
          if (joint !== undefined && at !== undefined && own.bones[`${side}${finger}Proximal`] === undefined)
            put(at, joint, side + finger + part);
        }
    for (const row of trunk(own, other)) rows.set(row.target, row);
  } else
    source.names.forEach((name, joint) => {
      const at = target.names.findIndex((each) => each.toLowerCase() === name.toLowerCase());
      if (at >= 0) put(at, joint, "");
    });
  const bones = new Map(Object.entries(own.bones).map(([bone, joint]) => [joint, bone]));
  for (const [name, at] of Object.entries(joints)) {
    const joint = source.names.indexOf(name);
    if (joint < 0) continue;
    for (const row of [...rows.values()]) {
      const nearer = row.share > 0.5 ? row.second : row.first;
      const alone = row.bone === "" || row.bone === bones.get(row.first);
      if (nearer === joint && (alone || at === "")) rows.delete(row.target);
    }
    const found = target.names.indexOf(at);
    if (found >= 0) put(found, joint, bones.get(joint) ?? trunkBone(own, joint, other, found), true);
  }
  return [...rows.values()].sort((a, b) => a.target - b.target);
}

/** `spine` or `neck` where both joints of a pair are of it. */
function trunkBone(own: Roles, joint: number, other: Roles, at: number): string {
  if (own.spine.includes(joint) && other.spine.includes(at)) return "spine";
  return own.neck.includes(joint) && other.neck.includes(at) ? "neck" : "";
}

function trunk(own: Roles, other: Roles): Row[] {
  const hips = own.bones.hips as number;
  const spine = other.spine.map((joint, k) =>
    along(joint, [hips, ...own.spine], ((k + 1) / other.spine.length) * own.spine.length, "spine"),
  );
  if (own.bones.head === undefined) return spine;
  const chain = [own.spine.at(-1) ?? hips, ...own.neck, own.bones.head];
  const step = (own.neck.length + 1) / (other.neck.length + 1);
  return [...spine, ...other.neck.map((joint, k) => along(joint, chain, (k + 1) * step, "neck"))];
}

function along(target: number, chain: readonly number[], at: number, bone: string): Row {
  const k = Math.min(Math.floor(at + 1e-9), chain.length - 1);
  const first = chain[k] as number;
  const share = k === chain.length - 1 || at - k < 1e-9 ? 0 : at - k;
  return { target, first, second: share > 0 ? (chain[k + 1] as number) : first, share, bone, given: false };
}

const NEXT: Readonly<Record<string, readonly string[]>> = {
  UpperArm: ["LowerArm"],
  LowerArm: ["Hand"],
  Hand: ["MiddleProximal", "IndexProximal"],
  UpperLeg: ["LowerLeg"],
  LowerLeg: ["Foot"],
  ThumbMetacarpal: ["ThumbProximal"],
  ThumbProximal: ["ThumbDistal"],
  ...Object.fromEntries(
    ["Index", "Middle", "Ring", "Little"].flatMap((finger) => [
      [`${finger}Proximal`, [`${finger}Intermediate`]],
      [`${finger}Intermediate`, [`${finger}Distal`]],
    ]),
  ),
};

const UPRIGHT = ["hips", "head", "spine", "neck", "Shoulder"];

/** Rotations from the target's standing pose to the source's, of each row; `base` is that of the body. */
export function alignment(
  source: Standing,
  target: Standing,
  rows: readonly Row[],
  above: readonly number[],
  base: Q,
): Q[] {
  const turns: Q[] = [];
  rows.forEach((row, k) => {
    const side = /^(left|right)/.exec(row.bone)?.[0] ?? "";
    const part = row.bone.slice(side.length);
    const inherited = turns[above[k] as number] ?? base;
    if (UPRIGHT.includes(part)) turns.push(base);
    else if (part === "Toes") turns.push(inherited);
    else if (part === "Foot") turns.push(footTurn(source, target, side, base));
    else turns.push(limbTurn(source, target, rows, k, above, side, part, inherited));
  });
  return turns;
}

function limbTurn(
  source: Standing,
  target: Standing,
  rows: readonly Row[],
  k: number,
  above: readonly number[],
  side: string,
  part: string,
  inherited: Q,
): Q {
  const row = rows[k] as Row;
  const below = part in NEXT ? [] : rows.filter((_, n) => above[n] === k);
  const next = NEXT[part]
    ?.map((after) => rows.find(({ bone }) => bone === side + after))
    .find((found) => found !== undefined);
  const to = next ?? (row.bone === "" && below.length === 1 ? below[0] : undefined);
  if (!to) return inherited;
  const place = (standing: Standing, joint: number) => standing.positions[joint] as V;
  const from = rotate(inherited, sub(place(target, to.target), place(target, row.target)));
  return multiply(arc(from, sub(place(source, to.first), place(source, row.first))), inherited);
}

function footTurn(source: Standing, target: Standing, side: string, base: Q): Q {
  const span = (standing: Standing) => {
    const [foot, toes] = [standing.at(`${side}Foot`), standing.at(`${side}Toes`)];
    return foot && toes ? sub(toes, foot) : null;
  };
  const [own, other] = [span(source), span(target)];
  if (!own || !other) return base;
  return multiply(arc(level(rotate(base, other), source.up), level(own, source.up)), base);
}

export const baseTurn = (source: Standing, target: Standing): Q => multiply(source.frame, inverse(target.frame));
