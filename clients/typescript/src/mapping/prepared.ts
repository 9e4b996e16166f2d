/** Preparation of a mapping: driven joints, lengths, soles and the effector; verbs/mapping/tables.py. */

import type { Skeleton } from "../math/kinematics.js";
import { alignment, baseTurn, plan, type RestJoint, type Row, Standing } from "./standing.js";
import {
  add,
  arc,
  dot,
  inverse,
  length,
  level,
  multiply,
  type Q,
  rotate,
  STILL,
  sub,
  times,
  type V,
} from "./vector.js";

/** Length of a bone that has one, in lengths of the target's legs. */
const LEAST_BONE = 1e-6;

/** What a mapping needs of a verb's description. */
export interface MappedVerb {
  looping: boolean;
  skeleton: Skeleton;
  keytime_names: readonly string[];
  keytime_phases: readonly number[];
  measure: { kind: string; effector: string | null; keytime: string | null };
  contacts: readonly { foot: string; points: readonly ContactPoint[] }[];
}

export interface ContactPoint {
  part: string;
  joint: string;
  offset: readonly number[];
  height: number;
}

export interface MapperOptions {
  /** Target joints by source joints, which replace those found by names; empty: left out. */
  joints?: Readonly<Record<string, string>>;
  goal?: "scaled" | "world";
  /** Joints of VRM bones that the file itself names. */
  bones?: Readonly<Record<string, number>>;
  /** Height of the ground in the file; null: below the lowest joint. */
  ground?: number | null;
}

/** Distances of the last pose, metres; null where there is nothing to keep. */
export interface MapFigures {
  effector: number | null;
  feet: number | null;
}

export interface Foot {
  source: [hip: number, knee: number, ankle: number, toe: number];
  chain: [hip: number, knee: number, ankle: number, toe: number];
  points: [V, V, V];
  own: [V, V, V];
  levels: V;
  ownLevels: V;
  known: [boolean, boolean, boolean];
  hinge: V;
}

export interface Effector {
  source: number;
  phase: number;
  before: number;
  after: number;
  driven: number;
  offset: V;
  arm: { source: [number, number, number]; chain: [number, number, number]; hinge: V } | null;
  foot: number;
}

/** A mapping, prepared: see {@link Mapper}. */
export class Prepared {
  readonly source: Standing;
  readonly target: Standing;
  readonly rows: readonly Row[];
  /** Lengths of the target per length of the source. */
  readonly scale: number;
  protected readonly above: number[];
  protected readonly standing: Q[];
  protected readonly offsets: V[];
  /** Inverse rotation of what lies between a driven joint and the one above it. */
  readonly before: Q[];
  protected readonly legs: number;
  protected readonly feet: Foot[];
  protected readonly effector: Effector | null;
  protected readonly middle: V;
  protected readonly goalScale: number;

  /** Throws where no joint can be mapped. */
  constructor(
    protected readonly verb: MappedVerb,
    joints: readonly RestJoint[],
    options: MapperOptions = {},
  ) {
    this.source = new Standing(restOf(verb.skeleton));
    const bones = { ...options.bones, ...givenBones(this.source, joints, options.joints) };
    this.target = new Standing(joints, bones, options.ground ?? null);
    const rows = plan(this.source, this.target, options.joints);
    if (rows.length === 0) throw new Error("No joint of this figure can be mapped: its bones are not known by name.");
    this.rows = rooted(rows, this.target);
    this.above = this.rows.map(({ target }) => this.drivenAbove(target));
    const base = baseTurn(this.source, this.target);
    const turns = alignment(this.source, this.target, this.rows, this.above, base);
    this.standing = this.rows.map(({ target }, k) => multiply(turns[k] as Q, this.target.rotations[target] as Q));
    const sole = this.soleThickness();
    this.legs = this.target.legs(sole);
    this.scale = this.legs / this.sourceLegs();
    this.goalScale = options.goal === "world" ? 1 : this.scale;
    this.offsets = this.rows.map(({ target }, k) => this.offsetOf(target, this.above[k] as number));
    this.before = this.rows.map(({ target }) => inverse(this.betweenOf(target)));
    this.middle = this.middleOf();
    this.feet = this.feetOf(base, sole);
    this.effector = this.effectorOf();
  }

  private drivenAbove(target: number): number {
    for (let joint = this.target.parents[target] ?? -1; joint >= 0; joint = this.target.parents[joint] ?? -1) {
      const k = this.rows.findIndex((row) => row.target === joint);
      if (k >= 0) return k;
    }
    return -1;
  }

  /** Rotation of the joints between a driven joint and the one above it; above the first, of all. */
  private betweenOf(target: number): Q {
    const stop = this.rows[this.drivenAbove(target)]?.target ?? -1;
    let turn = STILL;
    for (let joint = this.target.parents[target] ?? -1; joint !== stop; joint = this.target.parents[joint] ?? -1)
      turn = multiply(this.target.joints[joint]?.rotation ?? STILL, turn);
    return turn;
  }

  private offsetOf(target: number, above: number): V {
    const parent = this.rows[above]?.target;
    if (parent === undefined) return [0, 0, 0];
    const { positions, rotations } = this.target;
    return rotate(inverse(rotations[parent] as Q), sub(positions[target] as V, positions[parent] as V));
  }

  private middleOf(): V {
    const [left, right] = [this.target.at("leftUpperLeg"), this.target.at("rightUpperLeg")];
    const pelvis = this.rows[0]?.target ?? 0;
    if (!left || !right) return [0, 0, 0];
    const { positions, rotations } = this.target;
    return rotate(inverse(rotations[pelvis] as Q), sub(times(add(left, right), 0.5), positions[pelvis] as V));
  }

  private contactsOf(): { foot: number; points: ContactPoint[] }[] {
    const { names } = this.verb.skeleton;
    return this.verb.contacts.map(({ foot, points }) => ({ foot: names.indexOf(foot), points: [...points] }));
  }

  /** Length of a source's leg, and height of its standing pose's zero above the ground. */
  private standingLeg(foot: number, points: readonly ContactPoint[]): [number, number] {
    const { positions, rotations, parents } = this.source;
    const knee = parents[foot] as number;
    const hip = parents[knee] as number;
    const place = (joint: number) => positions[joint] as V;
    const ball = pointOf(points, 1);
    const carrier = this.verb.skeleton.names.indexOf(ball?.joint ?? "");
    const at = add(place(carrier), rotate(rotations[carrier] as Q, (ball?.offset ?? [0, 0, 0]) as unknown as V));
    const rise = Math.max((ball?.height ?? 0) - dot(sub(at, place(foot)), this.source.up), 0);
    const bones = length(sub(place(hip), place(knee))) + length(sub(place(knee), place(foot)));
    return [bones + rise, rise - dot(place(foot), this.source.up)];
  }

  private soleThickness(): number {
    const contacts = this.contactsOf();
    if (contacts.length === 0) return 0;
    const zero = mean(contacts.map(({ foot, points }) => this.standingLeg(foot, points)[1]));
    const tips = (this.verb.skeleton as { tips?: readonly { parent: number; offset: readonly number[] }[] }).tips ?? [];
    const { positions, rotations, up } = this.source;
    const ends = tips.map(({ parent, offset }) =>
      add(positions[parent] as V, rotate(rotations[parent] as Q, offset as unknown as V)),
    );
    const low = Math.min(...[...positions, ...ends].map((place) => dot(place, up)));
    return (Math.max(zero + low, 0) * this.target.legs()) / Math.max(this.source.legs(), 1e-6);
  }

  private sourceLegs(): number {
    const contacts = this.contactsOf();
    const found = contacts.map(({ foot, points }) => this.standingLeg(foot, points)[0]);
    return found.length > 0 ? mean(found) : this.source.legs();
  }

  private limb(joints: readonly number[]): [number, number, number] | null {
    const found = joints.map((joint) => this.rows.findIndex(({ first, share }) => first === joint && share === 0));
    const [a = -1, b = -1, c = -1] = found;
    if (Math.min(a, b, c) < 0 || this.above[b] !== a || this.above[c] !== b || (this.above[a] ?? -1) < 0) return null;
    const shortest = Math.min(...[b, c].map((k) => length(this.offsets[k] as V)));
    return shortest > LEAST_BONE * this.legs ? [a, b, c] : null; // a bone without length cannot bend
  }

  /** Hinge in the frame of the target's upper joint, by that of the standing source. */
  private hingeOf(axis: V, upper: number): V {
    return rotate(inverse(this.standing[upper] as Q), axis);
  }

  private feetOf(base: Q, sole: number): Foot[] {
    const { parents, names } = this.verb.skeleton;
    return this.contactsOf().flatMap(({ foot, points }) => {
      const knee = parents[foot] as number;
      const source = [parents[knee] as number, knee, foot] as const;
      const limb = this.limb(source);
      const tip = pointOf(points, 2);
      const toe = tip && parents[names.indexOf(tip.joint)] === foot ? names.indexOf(tip.joint) : -1;
      if (!limb) return [];
      const myToe = toe < 0 ? -1 : this.rows.findIndex(({ first }, k) => first === toe && this.above[k] === limb[2]);
      const hinge = this.hingeOf(rotate(this.source.frame, [1, 0, 0]), limb[0]);
      const shape = this.footShape(foot, points, toe, limb[2], myToe, base, sole);
      return [{ source: [...source, toe], chain: [...limb, myToe], hinge, ...shape } as Foot];
    });
  }

  private footShape(
    foot: number,
    points: readonly ContactPoint[],
    toe: number,
    mine: number,
    myToe: number,
    base: Q,
    sole: number,
  ) {
    const { positions, rotations } = this.source;
    const inFrame = (part: number): V => {
      const point = pointOf(points, part);
      const carrier = this.verb.skeleton.names.indexOf(point?.joint ?? "");
      if (!point || carrier < 0) return [0, 0, 0];
      const at = add(positions[carrier] as V, rotate(rotations[carrier] as Q, point.offset as unknown as V));
      const frame = part === 2 && toe >= 0 ? toe : foot;
      return rotate(inverse(rotations[frame] as Q), sub(at, positions[frame] as V));
    };
    const own = [inFrame(0), inFrame(1), inFrame(2)] as [V, V, V];
    const known = [0, 1, 2].map((part) => pointOf(points, part) !== undefined) as Foot["known"];
    const levels = [0, 1, 2].map((part) => pointOf(points, part)?.height ?? 0) as unknown as V;
    const { up } = this.target;
    const [ankle, toes] = [this.rows[mine]?.target as number, this.rows[myToe]?.target];
    const place = (joint: number) => this.target.positions[joint] as V;
    const back = inverse(base);
    const flat = (part: number) =>
      level(rotate(back, rotate(rotations[part === 2 && toe >= 0 ? toe : foot] as Q, own[part] as V)), up);
    const span = toes === undefined ? 0 : length(level(sub(place(toes), place(ankle)), up));
    const factor = span > 1e-6 ? span / Math.max(length(flat(1)), 1e-6) : this.scale;
    const floor = this.target.floor(sole);
    const ownLevels: number[] = [];
    const made = [0, 1, 2].map((part) => {
      const carrier = part === 2 && toes !== undefined ? toes : ankle;
      let at = part === 1 && toes !== undefined ? place(toes) : add(place(carrier), times(flat(part), factor));
      if (part !== 1 || toes === undefined)
        at = add(at, times(up, floor + this.scale * (levels[part] as number) - dot(at, up)));
      ownLevels.push(dot(at, up) - floor);
      return rotate(inverse(this.target.rotations[carrier] as Q), sub(at, place(carrier)));
    }) as [V, V, V];
    return { points: own, own: made, known, levels, ownLevels: ownLevels as unknown as V };
  }

  private effectorOf(): Effector | null {
    const { measure, keytime_names, keytime_phases, skeleton } = this.verb;
    const phase = keytime_phases[keytime_names.indexOf(measure.keytime ?? "")];
    const source = skeleton.names.indexOf(measure.effector ?? "");
    if (phase === undefined || source < 0) return null;
    const chain: number[] = [];
    for (let joint = source; joint >= 0; joint = skeleton.parents[joint] ?? -1) chain.push(joint);
    const nearest = chain.find((joint) => this.rows.some(({ first, share }) => first === joint && share === 0));
    if (nearest === undefined) return null;
    const driven = this.rows.findIndex(({ first, share }) => first === nearest && share === 0);
    const span = sub(this.source.positions[source] as V, this.source.positions[nearest] as V);
    const offset = times(rotate(inverse(this.standing[driven] as Q), span), this.scale);
    const earlier = keytime_phases.filter((each) => each < phase - 1e-9).at(-1);
    const later = keytime_phases.find((each) => each > phase + 1e-9);
    const foot = this.feet.findIndex((each) => each.source.slice(2).includes(nearest));
    const window = {
      before: earlier === undefined ? 1 : phase - earlier,
      after: later === undefined ? 1 : later - phase,
    };
    return { source, phase, ...window, driven, offset, foot, arm: foot < 0 ? this.armOf(chain) : null };
  }

  private armOf(chain: readonly number[]): Effector["arm"] {
    for (const [side, sign] of [
      ["left", 1],
      ["right", -1],
    ] as const) {
      const source = ["UpperArm", "LowerArm", "Hand"].map((part) => this.source.roles.bones[side + part] ?? -1);
      const limb = chain.includes(source[2] as number) ? this.limb(source) : null;
      if (!limb) continue;
      const [shoulder, elbow] = source.slice(0, 2).map((joint) => this.source.positions[joint] as V) as [V, V];
      const outward = rotate(this.source.frame, [sign, 0, 0]);
      const down = rotate(this.source.frame, [0, -sign, 0]);
      const axis = rotate(arc(outward, sub(elbow, shoulder)), down);
      return { source: source as [number, number, number], chain: limb, hinge: this.hingeOf(axis, limb[0]) };
    }
    return null;
  }
}

/** Bones of the target that pairs give: a joint that a bone of the source moves is that bone. */
function givenBones(source: Standing, joints: readonly RestJoint[], pairs: MapperOptions["joints"] = {}) {
  const named = Object.entries(source.roles.bones).map(([bone, joint]) => {
    const target = pairs[source.names[joint] ?? ""];
    return [bone, target ? joints.findIndex(({ name }) => name === target) : -1] as const;
  });
  return Object.fromEntries(named.filter(([, joint]) => joint >= 0));
}

/** A skeleton of a verb at rest. */
function restOf({ names, parents, offsets }: Skeleton): RestJoint[] {
  return names.map((name, k) => ({
    name,
    parent: parents[k] ?? -1,
    rotation: STILL,
    position: k === 0 ? [0, 0, 0] : (offsets[k] as unknown as V),
  }));
}

/** Rows with a driven joint above all others. */
function rooted(rows: Row[], target: Standing): Row[] {
  const chains = rows.map(({ target: joint }) => {
    const found: number[] = [];
    for (let each = joint; each >= 0; each = target.parents[each] ?? -1) found.push(each);
    return found;
  });
  const top = chains[0]?.find((joint) => chains.every((chain) => chain.includes(joint))) ?? 0;
  if (top === rows[0]?.target) return rows;
  const extra: Row = { target: top, first: 0, second: 0, share: 0, bone: "", given: false };
  return [extra, ...rows].sort((a, b) => a.target - b.target);
}

/** Heel, ball or tip of a foot; the one point of a foot without toes counts as its ball. */
function pointOf(points: readonly ContactPoint[], part: number): ContactPoint | undefined {
  const find = (name: string) => points.find((point) => point.part === name);
  if (part === 0) return find("heel");
  return part === 2 ? find("toe") : (find("ball") ?? find("foot") ?? points[0]);
}

const mean = (values: readonly number[]) => values.reduce((a, b) => a + b, 0) / values.length;
