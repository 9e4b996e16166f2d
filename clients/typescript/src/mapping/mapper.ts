/**
 * Poses of a verb on another skeleton, with feet on the ground and the effector on its goal; docs/mapping.md.
 *
 * The steps are those of verbs/kernels/mapped_pose.py.
 */

import type { Skeleton } from "../math/kinematics.js";
import { alignment, baseTurn, plan, type RestJoint, type Row, Standing } from "./standing.js";
import {
  about,
  add,
  arc,
  between,
  cross,
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
  unit,
  type V,
} from "./vector.js";

export type { RestJoint, Row } from "./standing.js";

/** What a mapping needs of a verb's description. */
export interface MappedVerb {
  looping: boolean;
  skeleton: Skeleton;
  keytime_names: readonly string[];
  keytime_phases: readonly number[];
  measure: { kind: string; effector: string | null; keytime: string | null };
  contacts: readonly { foot: string; points: readonly ContactPoint[] }[];
}

interface ContactPoint {
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

interface Foot {
  source: [hip: number, knee: number, ankle: number, toe: number];
  chain: [hip: number, knee: number, ankle: number, toe: number];
  points: [V, V, V];
  own: [V, V, V];
  levels: V;
  ownLevels: V;
  known: [boolean, boolean, boolean];
  hinge: V;
}

interface Effector {
  source: number;
  phase: number;
  before: number;
  after: number;
  driven: number;
  offset: V;
  arm: { source: [number, number, number]; chain: [number, number, number]; hinge: V } | null;
  foot: number;
}

const STRAIGHT = 0.995;
const EASY_LEG = 0.985;
const EASY = 0.95;
const KNEE = 0.98;
const MARGIN = 0.01;
const REACHED = 0.9985;
const SOFT_M = 0.005;
const SINK_M = 0.003;
const LOWEST_M = 0.004;
const LEAN_RAD = 0.6;
const SHIFT = 0.2;
const SINK = 0.3;
const NEAR = 0.12;
const STEPS = 4;
const STANDS_M = 0.012;

export class Mapper {
  readonly source: Standing;
  readonly target: Standing;
  readonly rows: readonly Row[];
  /** Lengths of the target per length of the source. */
  readonly scale: number;
  readonly figures: MapFigures = { effector: null, feet: null };
  /** Local rotations of the driven joints, as in `rows`, and the place of the first, metres. */
  readonly local: Q[] = [];
  root: V = [0, 0, 0];
  /** Global rotations of the driven joints. */
  readonly turns: Q[] = [];
  private readonly above: number[];
  private readonly standing: Q[];
  private readonly offsets: V[];
  /** Inverse rotation of what lies between a driven joint and the one above it. */
  readonly before: Q[];
  private readonly legs: number;
  private readonly feet: Foot[];
  private readonly effector: Effector | null;
  private readonly middle: V;
  private readonly goalScale: number;
  private readonly turned: Q[] = [];
  private readonly placed: V[] = [];
  private readonly places: V[] = [];

  /** Throws where no joint can be mapped. */
  constructor(
    private readonly verb: MappedVerb,
    joints: readonly RestJoint[],
    options: MapperOptions = {},
  ) {
    this.source = new Standing(restOf(verb.skeleton));
    this.target = new Standing(joints, options.bones, options.ground ?? null);
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

  /**
   * Map one pose, root x, y, z and local x, y, z, w per joint; results are in `local`, `turns`, `root` and `figures`.
   *
   * @param phase null: the effector has no goal
   */
  apply(values: ArrayLike<number>, phase: number | null): void {
    this.solveSource(values);
    this.follow();
    this.placePelvis();
    this.forward();
    const goals = this.feet.map((foot) => this.footGoal(foot));
    this.reach(goals, phase);
    this.forward();
    this.measure(goals);
  }

  /** Place of the effector in the last pose, metres; null without one. */
  effectorPlace(): V | null {
    return this.effector && this.placed.length > 0 ? this.carried(this.effector) : null;
  }

  private solveSource(values: ArrayLike<number>): void {
    const { parents, offsets } = this.verb.skeleton;
    parents.forEach((parent, j) => {
      const at = 3 + 4 * j;
      const q = [values[at], values[at + 1], values[at + 2], values[at + 3]] as unknown as Q;
      if (parent < 0) {
        this.turned[j] = q;
        this.placed[j] = [values[0] as number, values[1] as number, values[2] as number];
        return;
      }
      const turn = this.turned[parent] as Q;
      this.turned[j] = multiply(turn, q);
      this.placed[j] = add(this.placed[parent] as V, rotate(turn, offsets[j] as unknown as V));
    });
  }

  private since(joint: number): Q {
    return multiply(this.turned[joint] as Q, inverse(this.source.rotations[joint] as Q));
  }

  private follow(): void {
    this.rows.forEach(({ first, second, share }, k) => {
      const turn = share > 0 ? between(this.since(first), this.since(second), share) : this.since(first);
      const q = multiply(turn, this.standing[k] as Q);
      const above = this.above[k] as number;
      this.turns[k] = q;
      this.local[k] = above >= 0 ? multiply(inverse(this.turns[above] as Q), q) : q;
    });
  }

  private forward(): void {
    this.local.forEach((q, k) => {
      const above = this.above[k] as number;
      this.turns[k] = above < 0 ? q : multiply(this.turns[above] as Q, q);
      this.places[k] =
        above < 0 ? this.root : add(this.places[above] as V, rotate(this.turns[above] as Q, this.offsets[k] as V));
    });
  }

  private placePelvis(): void {
    const { leftUpperLeg: left, rightUpperLeg: right } = this.source.roles.bones;
    const first = this.rows[0]?.first ?? 0;
    const both = left !== undefined && right !== undefined && this.feet.length > 0;
    const point = both ? times(add(this.placed[left] as V, this.placed[right] as V), 0.5) : (this.placed[first] as V);
    this.root = sub(times(point, this.scale), rotate(this.turns[0] as Q, this.middle));
  }

  private footGoal(foot: Foot): { ankle: V; ball: V; clearance: number } {
    const [, , ankle, toe] = foot.source;
    const [, , mine, myToe] = foot.chain;
    const end = toe >= 0 ? toe : ankle;
    const heights = (base: V, q: Q, tipBase: V, tipQ: Q, points: Foot["points"], levels: V) =>
      points.map((point, p) => add(p < 2 ? base : tipBase, rotate(p < 2 ? q : tipQ, point))[1] - (levels[p] as number));
    const source = heights(
      this.placed[ankle] as V,
      this.turned[ankle] as Q,
      this.placed[end] as V,
      this.turned[end] as Q,
      foot.points,
      foot.levels,
    );
    const clearance = lowest(source, foot.known);
    const at = times(add(this.placed[ankle] as V, rotate(this.turned[ankle] as Q, foot.points[1])), this.scale);
    const ball: V = [at[0], at[1] - this.scale * foot.levels[1] + foot.ownLevels[1], at[2]];
    const q = this.turns[mine] as Q;
    const place = sub(ball, rotate(q, foot.own[1]));
    const tip = myToe >= 0 ? add(place, rotate(q, this.offsets[myToe] as V)) : place;
    const tipQ = this.turns[myToe >= 0 ? myToe : mine] as Q;
    const rise = this.scale * clearance - lowest(heights(place, q, tip, tipQ, foot.own, foot.ownLevels), foot.known);
    return { ankle: add(place, [0, rise, 0]), ball: add(ball, [0, rise, 0]), clearance };
  }

  /** Sink, lean and the inverse kinematics of limbs. */
  private reach(goals: { ankle: V; clearance: number }[], phase: number | null): void {
    const effector = this.effector;
    const weight = effector && phase !== null ? weightAt(effector, phase, this.verb.looping) : 0;
    const ends = this.feet.map(({ chain }) => this.turns[chain[2]] as Q);
    if (effector && weight > 0 && effector.foot >= 0) this.aimFoot(effector, weight, goals);
    const sunk = this.sink(goals);
    this.root = add(this.root, [0, -sunk, 0]);
    this.forward();
    const arm = effector?.arm;
    let wrist: V | null = null;
    let hand = STILL;
    if (effector && arm && weight > 0) {
      const [upper, lower, end] = arm.chain;
      hand = this.turns[end] as Q;
      const now = this.carried(effector);
      const aim = add(now, times(sub(this.goalOf(effector), now), weight));
      wrist = add(this.places[end] as V, sub(aim, now));
      const whole = this.span(upper, lower) + this.span(lower, end);
      const stretch = Math.min(this.stretch(arm.source), REACHED);
      const missing = this.lean(arm.chain[0], wrist, whole * Math.max(EASY, stretch));
      if (missing > 0) {
        const left = this.sink(goals);
        this.shift(upper, wrist, missing);
        this.forward();
        this.root = add(this.root, [0, -above(this.sink(goals) - left - SINK_M, SINK_M), 0]);
        this.forward();
      }
      wrist = this.within(upper, wrist, whole, Math.max(KNEE, Math.min(stretch + MARGIN, REACHED - 1e-3), stretch));
    }
    this.feet.forEach(({ chain, hinge }, f) => {
      this.bend([chain[0], chain[1], chain[2]], hinge, goals[f]?.ankle as V, ends[f] as Q, STRAIGHT);
    });
    if (arm && wrist) this.bend(arm.chain, arm.hinge, wrist, hand, 0.9999);
  }

  private goalOf(effector: Effector): V {
    return times(this.placed[effector.source] as V, this.goalScale);
  }

  private carried({ driven, offset }: Effector): V {
    return add(this.places[driven] as V, rotate(this.turns[driven] as Q, offset));
  }

  private span(a: number, b: number): number {
    return length(sub(this.places[a] as V, this.places[b] as V));
  }

  /** Share of its length to which a limb of the source is stretched. */
  private stretch([upper, lower, end]: readonly number[]): number {
    const gap = (a: number | undefined, b: number | undefined) =>
      length(sub(this.placed[a ?? 0] as V, this.placed[b ?? 0] as V));
    return gap(upper, end) / Math.max(gap(upper, lower) + gap(lower, end), 1e-9);
  }

  private aimFoot(effector: Effector, weight: number, goals: { ankle: V; clearance: number }[]): void {
    const foot = this.feet[effector.foot] as Foot;
    const goal = goals[effector.foot] as { ankle: V; clearance: number };
    const [hip, knee, ankle] = foot.chain;
    const free = smooth(Math.max(this.scale * goal.clearance, 0) / (0.06 * this.legs));
    const share = weight * (free + (1 - free) * weight ** 8);
    const wanted = add(this.places[ankle] as V, sub(this.goalOf(effector), this.carried(effector)));
    const aim = add(goal.ankle, times(sub(wanted, goal.ankle), share));
    const stretch = Math.min(this.stretch(foot.source), REACHED);
    const whole = this.span(hip, knee) + this.span(knee, ankle);
    const limit = whole * Math.max(EASY_LEG, stretch);
    const missing = above(length(sub(aim, this.places[hip] as V)) - limit - SOFT_M, SOFT_M);
    if (missing > 0) {
      this.shift(hip, aim, share * missing);
      this.forward();
    }
    goal.ankle = this.within(hip, aim, whole, Math.max(EASY_LEG, stretch));
  }

  /** How far the pelvis sinks so that feet near the ground are within reach. */
  private sink(goals: readonly { ankle: V; clearance: number }[]): number {
    let total = 0;
    this.feet.forEach(({ chain, source }, f) => {
      const { ankle, clearance } = goals[f] as { ankle: V; clearance: number };
      const limit =
        Math.max(EASY_LEG, this.stretch(source)) * (this.span(chain[0], chain[1]) + this.span(chain[1], chain[2]));
      const hip = this.places[chain[0]] as V;
      const room = limit ** 2 - (hip[0] - ankle[0]) ** 2 - (hip[2] - ankle[2]) ** 2;
      const low = room > 0.01 * limit ** 2 ? Math.sqrt(room) : 0.1 * limit;
      const need = above(hip[1] - ankle[1] - low - SINK_M, SINK_M);
      total += (need * (1 - smooth(Math.max(this.scale * clearance, 0) / (NEAR * this.legs)))) ** 4;
    });
    return limited(total ** 0.25, SINK * this.legs);
  }

  /** Lean the trunk towards a goal out of the arm's reach; what is still missing. */
  private lean(shoulder: number, goal: V, limit: number): number {
    const spine = this.rows.flatMap(({ bone }, k) => (bone === "spine" && this.isAbove(k, shoulder) ? [k] : []));
    let left = LEAN_RAD;
    for (let step = 0; ; step++) {
      this.forward();
      const gap = sub(goal, this.places[shoulder] as V);
      const size = Math.max(length(gap), 1e-9);
      const missing = above(size - limit - SOFT_M, SOFT_M);
      if (step === STEPS || spine.length === 0 || missing <= 0) return missing;
      const arm = sub(this.places[shoulder] as V, this.places[spine[0] as number] as V);
      const turn = arc(arm, add(arm, times(gap, missing / size)));
      const sine = Math.hypot(turn[0], turn[1], turn[2]);
      if (sine < 1e-12) return missing;
      const angle = limited(2 * Math.atan2(sine, turn[3]), left);
      left -= angle;
      const part = about([turn[0] / sine, turn[1] / sine, turn[2] / sine], angle / spine.length);
      for (const k of spine) {
        const parent = this.turns[this.above[k] as number] as Q;
        this.local[k] = multiply(multiply(inverse(parent), part), multiply(parent, this.local[k] as Q));
      }
    }
  }

  private isAbove(k: number, joint: number): boolean {
    for (let each = joint; each >= 0; each = this.above[each] as number) if (each === k) return true;
    return false;
  }

  /** Move the pelvis towards a goal, down freely and up not at all. */
  private shift(shoulder: number, goal: V, missing: number): void {
    const gap = sub(goal, this.places[shoulder] as V);
    const [x, y, z] = times(gap, limited(missing, SHIFT * this.legs) / Math.max(length(gap), 1e-9));
    this.root = add(this.root, [x, -above(-y - SINK_M, SINK_M), z]);
  }

  private within(joint: number, goal: V, whole: number, knee: number): V {
    const from = this.places[joint] as V;
    const size = length(sub(goal, from));
    const beyond = size / whole - knee;
    if (beyond <= 0) return goal;
    const give = Math.max(REACHED - knee, 5e-4);
    return add(from, times(sub(goal, from), (whole * (knee + give * (1 - Math.exp(-beyond / give)))) / size));
  }

  /** Put the end of a limb to a goal, with a global rotation, by two-bone inverse kinematics. */
  private bend([upper, lower, end]: readonly [number, number, number], hinge: V, goal: V, hand: Q, most: number): void {
    this.forward();
    const [a, b, c] = [upper, lower, end].map((k) => this.places[k] as V) as [V, V, V];
    const [u, l, line] = [sub(b, a), sub(c, b), sub(goal, a)];
    const [first, second] = [length(u), length(l)];
    const whole = first + second;
    const free = Math.max(most * whole, Math.min(length(sub(c, a)), 0.9999 * whole));
    let distance = Math.max(length(line), 1e-9);
    if (distance > free) {
      const give = Math.min(0.003 * whole, Math.max(0.5 * (whole - free), 1e-6));
      distance = free + give * (1 - Math.exp(-(distance - free) / give));
    }
    distance = Math.max(distance, 1.05 * Math.abs(first - second) + 1e-3);
    const usual = rotate(this.turns[upper] as Q, hinge);
    const plane = times(cross(u, l), 1 / (first * second));
    const near = 0.1 * Math.max(1 - length(plane) / 0.5, 0) * (dot(plane, usual) < 0 ? -1 : 1);
    const axis = unit(add(plane, times(usual, near)));
    const bent = Math.atan2(dot(cross(u, l), axis), dot(u, l));
    const cosine = (first ** 2 + second ** 2 - distance ** 2) / (2 * first * second);
    const turn = about(axis, Math.PI - Math.acos(Math.min(Math.max(cosine, -1), 1)) - bent);
    const aim = arc(add(u, rotate(turn, l)), line);
    const top = multiply(aim, this.turns[upper] as Q);
    const middle = multiply(aim, multiply(turn, this.turns[lower] as Q));
    this.local[upper] = multiply(inverse(this.turns[this.above[upper] as number] as Q), top);
    this.local[lower] = multiply(inverse(top), middle);
    this.local[end] = multiply(inverse(middle), hand);
    this.forward();
  }

  private measure(goals: readonly { ball: V; clearance: number }[]): void {
    let worst: number | null = null;
    this.feet.forEach(({ chain, own }, f) => {
      const { ball, clearance } = goals[f] as { ball: V; clearance: number };
      if (clearance > STANDS_M) return;
      const place = add(this.places[chain[2]] as V, rotate(this.turns[chain[2]] as Q, own[1]));
      worst = Math.max(worst ?? 0, length(sub(place, ball)));
    });
    this.figures.feet = worst;
    this.figures.effector = this.effector ? length(sub(this.carried(this.effector), this.goalOf(this.effector))) : null;
  }

  // ---- preparation

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
    return Math.min(a, b, c) >= 0 && this.above[b] === a && this.above[c] === b && (this.above[a] ?? -1) >= 0
      ? [a, b, c]
      : null;
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

function weightAt({ phase, before, after }: Effector, at: number, looping: boolean): number {
  let gap = at - phase;
  if (looping) gap -= Math.round(gap);
  const u = Math.min(Math.max(1 - Math.abs(gap) / Math.max(gap < 0 ? before : after, 1e-9), 0), 1);
  return u * u * u * (10 + u * (6 * u - 15));
}

/** Least of the known heights, smooth, and exact where they are equal. */
function lowest(heights: readonly number[], known: readonly boolean[]): number {
  const used = heights.filter((_, p) => known[p]);
  const least = Math.min(...used);
  const weights = used.map((height) => Math.exp((least - height) / LOWEST_M));
  return used.reduce((sum, height, p) => sum + height * (weights[p] as number), 0) / weights.reduce((a, b) => a + b);
}

const mean = (values: readonly number[]) => values.reduce((a, b) => a + b, 0) / values.length;

function above(value: number, soft: number): number {
  if (value <= -soft) return 0;
  return value >= soft ? value : (value + soft) ** 2 / (4 * soft);
}

function limited(value: number, most: number): number {
  const half = 0.5 * most;
  return value <= half ? value : most - (half * half) / value;
}

function smooth(value: number): number {
  const u = Math.min(Math.max(value, 0), 1);
  return u * u * (3 - 2 * u);
}
