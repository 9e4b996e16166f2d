/**
 * Poses on another skeleton, by joint names and rest poses; for the helpers of engines.
 *
 * Both skeletons stand in their rest poses, with the same facing. A mapped bone gets the global rotation of its joint,
 * and keeps the direction that it has relative to the joint's limb at rest. So the bones' axes may be any, and a rest
 * pose with lowered arms becomes one with raised arms. Lengths stay those of the target.
 */

import { rigOf, type Skeleton, solve } from "../math/kinematics.js";
import { multiply, normalize, rotate } from "../math/quaternion.js";

/** A pose of this package: of a stream's figure or of an evaluator. */
export interface PoseValues {
  values: Float32Array | Float64Array;
  skeleton: Skeleton;
}

/** Names of the target's bones by the verb's joints. */
export type JointMap = Readonly<Record<string, string>>;

/** Bone of the target in its rest pose, relative to its parent. */
export interface TargetBone {
  name: string;
  /** Index of the parent, which comes before; -1: none. */
  parent: number;
  rotation: readonly [number, number, number, number];
  position: readonly [number, number, number];
  /** Uniform scale relative to the parent. */
  scale: number;
}

/** Receives rotations, and the position of the bone of the root. */
export interface BoneWriter {
  rotation(bone: number, x: number, y: number, z: number, w: number): void;
  position(bone: number, x: number, y: number, z: number): void;
}

const IDENTITY = [0, 0, 0, 1];

export class Retarget {
  private readonly rig;
  /** Joint of each bone; -1: none. */
  private readonly joints: Int32Array;
  /** What follows the joint's global rotation: 4 per bone. */
  private readonly corrections: Float64Array;
  /** Rest pose of the target in its own space: rotations 4, positions 3 and scale 1 per bone. */
  private readonly rest: { rotations: Float64Array; positions: Float64Array; scales: Float64Array };
  private readonly heightRatio: number;
  private readonly positions: Float64Array;
  private readonly rotations: Float64Array;
  private readonly global: Float64Array;

  constructor(
    skeleton: Skeleton,
    private readonly bones: readonly TargetBone[],
    map: JointMap = {},
  ) {
    this.rig = rigOf(skeleton);
    this.positions = new Float64Array(3 * this.rig.joints);
    this.rotations = new Float64Array(4 * this.rig.joints);
    this.global = new Float64Array(4 * bones.length);
    this.corrections = new Float64Array(4 * bones.length);
    this.joints = matched(skeleton.names, bones, map);
    this.rest = restOf(bones);
    const positions = this.restPositions();
    const turns: number[][] = [];
    this.joints.forEach((joint, bone) => {
      if (joint >= 0) this.correct(bone, joint, positions, turns);
    });
    this.heightRatio = this.ratio(positions);
  }

  /** Number of mapped bones. */
  get mapped(): number {
    return this.joints.filter((joint) => joint >= 0).length;
  }

  /** Write the target's rotations relative to parents, and the position of the root's bone. */
  apply(values: ArrayLike<number>, writer: BoneWriter): void {
    const { global, rotations, joints, bones } = this;
    solve(this.rig, values as Float64Array, 0, this.positions, rotations);
    const local = [0, 0, 0, 1];
    bones.forEach(({ parent, rotation }, bone) => {
      const joint = joints[bone] as number;
      if (joint < 0) {
        if (parent < 0) global.set(rotation, 4 * bone);
        else multiply(global, 4 * bone, global, 4 * parent, [...rotation], 0);
        return;
      }
      multiply(global, 4 * bone, rotations, 4 * joint, this.corrections, 4 * bone);
      if (parent < 0) local.splice(0, 4, ...global.subarray(4 * bone, 4 * bone + 4));
      else multiply(local, 0, inverse(global, 4 * parent), 0, global, 4 * bone);
      writer.rotation(bone, local[0] as number, local[1] as number, local[2] as number, local[3] as number);
      if (joint === 0) this.writeRoot(bone, values, writer);
    });
  }

  private writeRoot(bone: number, values: ArrayLike<number>, writer: BoneWriter): void {
    const { parent } = this.bones[bone] as TargetBone;
    const { heightRatio: ratio, rest } = this;
    const point = [0, 1, 2].map(
      (a) => ratio * (values[a] as number) - (parent < 0 ? 0 : (rest.positions[3 * parent + a] as number)),
    );
    if (parent >= 0) rotate(point, 0, inverse(this.global, 4 * parent), 0, [...point], 0);
    const scale = parent < 0 ? 1 : (rest.scales[parent] as number);
    writer.position(bone, (point[0] as number) / scale, (point[1] as number) / scale, (point[2] as number) / scale);
  }

  /** Joint positions at rest. */
  private restPositions(): Float64Array {
    const values = new Float64Array(3 + 4 * this.rig.joints);
    for (let j = 0; j < this.rig.joints; j++) values[6 + 4 * j] = 1;
    const positions = new Float64Array(3 * this.rig.joints);
    solve(this.rig, values, 0, positions, this.rotations);
    return positions;
  }

  /**
   * The rotation that brings the bone's limb to the direction of the joint's, then the bone's rest rotation. A bone at
   * the end, or with several limbs, turns as the bone above it.
   */
  private correct(bone: number, joint: number, positions: Float64Array, turns: number[][]): void {
    const child = this.onlyChild(bone);
    const turn = [...(turns[this.mappedParent(bone)] ?? IDENTITY)];
    if (child >= 0) {
      const from = difference(this.rest.positions, child, bone);
      arc(turn, from, difference(positions, this.joints[child] as number, joint));
    }
    turns[bone] = turn;
    multiply(this.corrections, 4 * bone, turn, 0, this.rest.rotations, 4 * bone);
  }

  /** The only mapped bone below a bone, with none in between; -1 if there are none or several. */
  private onlyChild(bone: number): number {
    const below = this.bones.flatMap((_, each) =>
      this.mappedParent(each) === bone && this.joints[each] !== -1 ? [each] : [],
    );
    const [first] = below;
    return below.length === 1 && first !== undefined ? first : -1;
  }

  private mappedParent(bone: number): number {
    let parent = this.bones[bone]?.parent ?? -1;
    while (parent >= 0 && (this.joints[parent] as number) < 0) parent = this.bones[parent]?.parent ?? -1;
    return parent;
  }

  /** Height of the target's root above its lowest bone, relative to the verb's. */
  private ratio(positions: Float64Array): number {
    const root = this.joints.indexOf(0);
    if (root < 0) return 1;
    const heights = (points: Float64Array) => points.filter((_, k) => k % 3 === 1);
    const mapped = this.rest.positions.filter((_, k) => (this.joints[Math.floor(k / 3)] as number) >= 0);
    const theirs = (this.rest.positions[3 * root + 1] as number) - Math.min(...heights(mapped));
    const ours = -Math.min(...heights(positions));
    return ours > 0 && theirs > 0 ? theirs / ours : 1;
  }
}

/** A node of an engine that is a bone, and the index of its parent among the bones; -1: none. */
export interface BoneNode<Node> {
  node: Node;
  name: string;
  parent: number;
}

/** Rest pose of a node relative to its parent. */
export type Rest = Pick<TargetBone, "rotation" | "position" | "scale">;

interface Bound<Node> {
  skeleton: Skeleton;
  map: JointMap;
  nodes: readonly Node[];
  retarget: Retarget;
}

/** Targets by identity. A node keeps the rest pose of its first call: other joints or another map do not read it again. */
export class Bindings<Target extends object, Node extends object> {
  private readonly bound = new WeakMap<Target, Bound<Node>>();
  private readonly rests = new WeakMap<Node, Rest>();

  /** @param bonesOf bones of a target, parents before children */
  constructor(
    private readonly bonesOf: (target: Target, skeleton: Skeleton, map: JointMap) => readonly BoneNode<Node>[],
    private readonly restOf: (node: Node, target: Target) => Rest,
  ) {}

  of(target: Target, skeleton: Skeleton, map: JointMap = {}): Readonly<Bound<Node>> {
    const known = this.bound.get(target);
    if (known && sameMap(known.map, map) && sameSkeleton(known.skeleton, skeleton)) {
      known.skeleton = skeleton;
      return known;
    }
    const rows = this.bonesOf(target, skeleton, map);
    const bones = rows.map(({ node, name, parent }) => ({ name, parent, ...this.rest(node, target) }));
    const nodes = rows.map(({ node }) => node);
    const made = { skeleton, map: { ...map }, nodes, retarget: new Retarget(skeleton, bones, map) };
    this.bound.set(target, made);
    return made;
  }

  private rest(node: Node, target: Target): Rest {
    const rest = this.rests.get(node) ?? this.restOf(node, target);
    this.rests.set(node, rest);
    return rest;
  }
}

function sameMap(a: JointMap, b: JointMap): boolean {
  const names = Object.keys(b);
  return names.length === Object.keys(a).length && names.every((name) => a[name] === b[name]);
}

function sameSkeleton(a: Skeleton, b: Skeleton): boolean {
  if (a === b) return true;
  const keys = [a, b].map(({ names, parents, offsets }) => JSON.stringify([names, parents, offsets]));
  return keys[0] === keys[1];
}

/** Joint of each bone, by the map or by equal names without prefix and case. */
function matched(names: readonly string[], bones: readonly TargetBone[], map: JointMap): Int32Array {
  const joints = new Map<string, number>();
  names.forEach((name, j) => {
    const given = map[name];
    joints.set(given ?? plain(name), j);
  });
  return Int32Array.from(bones, ({ name }) => joints.get(name) ?? joints.get(plain(name)) ?? -1);
}

function plain(name: string): string {
  return name
    .slice(name.lastIndexOf(":") + 1)
    .replace(/^mixamorig\d*/, "")
    .replace(/[^a-z0-9]/gi, "")
    .toLowerCase();
}

function restOf(bones: readonly TargetBone[]) {
  const rotations = new Float64Array(4 * bones.length);
  const positions = new Float64Array(3 * bones.length);
  const scales = new Float64Array(bones.length);
  bones.forEach(({ parent, rotation, position, scale }, bone) => {
    if (parent < 0) {
      rotations.set(rotation, 4 * bone);
      positions.set(position, 3 * bone);
      scales[bone] = scale;
      return;
    }
    const unit = scales[parent] as number;
    multiply(rotations, 4 * bone, rotations, 4 * parent, [...rotation], 0);
    rotate(
      positions,
      3 * bone,
      rotations,
      4 * parent,
      position.map((value) => unit * value),
      0,
    );
    for (let a = 0; a < 3; a++)
      positions[3 * bone + a] = (positions[3 * bone + a] as number) + (positions[3 * parent + a] as number);
    scales[bone] = unit * scale;
  });
  return { rotations, positions, scales };
}

function inverse(q: ArrayLike<number>, i: number): number[] {
  return [-(q[i] as number), -(q[i + 1] as number), -(q[i + 2] as number), q[i + 3] as number];
}

function difference(points: Float64Array, a: number, b: number): number[] {
  return [0, 1, 2].map((k) => (points[3 * a + k] as number) - (points[3 * b + k] as number));
}

/** Shortest rotation from one direction to another; the identity where one has no length. */
function arc(out: number[], from: number[], to: number[]): void {
  const [a, b] = [Math.hypot(...from), Math.hypot(...to)];
  if (!(a > 1e-9 && b > 1e-9)) return;
  const [ax, ay, az] = from.map((value) => value / a) as [number, number, number];
  const [bx, by, bz] = to.map((value) => value / b) as [number, number, number];
  const dot = ax * bx + ay * by + az * bz;
  if (dot < -0.9999) return; // opposite: no direction is shortest
  out.splice(0, 4, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx, 1 + dot);
  normalize(out, 0);
}
