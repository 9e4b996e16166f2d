/**
 * Poses of a verb on another skeleton, with feet on the ground and the effector on its goal; docs/mapping.md.
 *
 * The steps are those of verbs/kernels/mapped_pose.py.
 */

import { type Effector, type Foot, type MapFigures, Prepared } from "./prepared.js";
import {
  about,
  add,
  arc,
  between,
  cross,
  dot,
  inverse,
  length,
  multiply,
  type Q,
  rotate,
  STILL,
  sub,
  times,
  unit,
  type V,
} from "./vector.js";

export type { MapFigures, MappedVerb, MapperOptions } from "./prepared.js";
export type { RestJoint, Row } from "./standing.js";

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

export class Mapper extends Prepared {
  readonly figures: MapFigures = { effector: null, feet: null };
  /** Local rotations of the driven joints, as in `rows`, and the position of the first, metres. */
  readonly local: Q[] = [];
  root: V = [0, 0, 0];
  /** Global rotations of the driven joints. */
  readonly rotations: Q[] = [];
  private readonly turned: Q[] = [];
  private readonly placed: V[] = [];
  private readonly places: V[] = [];

  /**
   * Map one pose, root x, y, z and local x, y, z, w per joint; results are in `local`, `rotations`, `root` and `figures`.
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

  /** Position of the effector in the last pose, metres; null without one. */
  effectorPosition(): V | null {
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
      this.rotations[k] = q;
      this.local[k] = above >= 0 ? multiply(inverse(this.rotations[above] as Q), q) : q;
    });
  }

  private forward(): void {
    this.local.forEach((q, k) => {
      const above = this.above[k] as number;
      this.rotations[k] = above < 0 ? q : multiply(this.rotations[above] as Q, q);
      this.places[k] =
        above < 0 ? this.root : add(this.places[above] as V, rotate(this.rotations[above] as Q, this.offsets[k] as V));
    });
  }

  private placePelvis(): void {
    const { leftUpperLeg: left, rightUpperLeg: right } = this.source.roles.bones;
    const first = this.rows[0]?.first ?? 0;
    const both = left !== undefined && right !== undefined && this.feet.length > 0;
    const point = both ? times(add(this.placed[left] as V, this.placed[right] as V), 0.5) : (this.placed[first] as V);
    this.root = sub(times(point, this.scale), rotate(this.rotations[0] as Q, this.middle));
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
    const q = this.rotations[mine] as Q;
    const place = sub(ball, rotate(q, foot.own[1]));
    const tip = myToe >= 0 ? add(place, rotate(q, this.offsets[myToe] as V)) : place;
    const tipQ = this.rotations[myToe >= 0 ? myToe : mine] as Q;
    const rise = this.scale * clearance - lowest(heights(place, q, tip, tipQ, foot.own, foot.ownLevels), foot.known);
    return { ankle: add(place, [0, rise, 0]), ball: add(ball, [0, rise, 0]), clearance };
  }

  /** Sink, lean and the inverse kinematics of limbs. */
  private reach(goals: { ankle: V; clearance: number }[], phase: number | null): void {
    const effector = this.effector;
    const weight = effector && phase !== null ? weightAt(effector, phase, this.verb.looping) : 0;
    const ends = this.feet.map(({ chain }) => this.rotations[chain[2]] as Q);
    if (effector && weight > 0 && effector.foot >= 0) this.aimFoot(effector, weight, goals);
    const sunk = this.sink(goals);
    this.root = add(this.root, [0, -sunk, 0]);
    this.forward();
    const arm = effector?.arm;
    let wrist: V | null = null;
    let hand = STILL;
    if (effector && arm && weight > 0) {
      const [upper, lower, end] = arm.chain;
      hand = this.rotations[end] as Q;
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
    return add(this.places[driven] as V, rotate(this.rotations[driven] as Q, offset));
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
        const parent = this.rotations[this.above[k] as number] as Q;
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
    const usual = rotate(this.rotations[upper] as Q, hinge);
    const plane = times(cross(u, l), 1 / (first * second));
    const near = 0.1 * Math.max(1 - length(plane) / 0.5, 0) * (dot(plane, usual) < 0 ? -1 : 1);
    const axis = unit(add(plane, times(usual, near)));
    const bent = Math.atan2(dot(cross(u, l), axis), dot(u, l));
    const cosine = (first ** 2 + second ** 2 - distance ** 2) / (2 * first * second);
    const turn = about(axis, Math.PI - Math.acos(Math.min(Math.max(cosine, -1), 1)) - bent);
    const aim = arc(add(u, rotate(turn, l)), line);
    const top = multiply(aim, this.rotations[upper] as Q);
    const middle = multiply(aim, multiply(turn, this.rotations[lower] as Q));
    this.local[upper] = multiply(inverse(this.rotations[this.above[upper] as number] as Q), top);
    this.local[lower] = multiply(inverse(top), middle);
    this.local[end] = multiply(inverse(middle), hand);
    this.forward();
  }

  private measure(goals: readonly { ball: V; clearance: number }[]): void {
    let worst: number | null = null;
    this.feet.forEach(({ chain, own }, f) => {
      const { ball, clearance } = goals[f] as { ball: V; clearance: number };
      if (clearance > STANDS_M) return;
      const place = add(this.places[chain[2]] as V, rotate(this.rotations[chain[2]] as Q, own[1]));
      worst = Math.max(worst ?? 0, length(sub(place, ball)));
    });
    this.figures.feet = worst;
    this.figures.effector = this.effector ? length(sub(this.carried(this.effector), this.goalOf(this.effector))) : null;
  }
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
