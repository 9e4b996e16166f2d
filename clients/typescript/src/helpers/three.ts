/** Poses on skeletons of three.js. Nothing of three.js is imported. */

import { type BoneWriter, type JointMap, type PoseValues, Retarget, type TargetBone } from "./retarget.js";

export type { JointMap, PoseValues } from "./retarget.js";

/** The part of three's `Object3D` that is used. */
export interface Node3D {
  name: string;
  parent: Node3D | null;
  children: readonly Node3D[];
  quaternion: { x: number; y: number; z: number; w: number; set(x: number, y: number, z: number, w: number): unknown };
  position: { x: number; y: number; z: number; set(x: number, y: number, z: number): unknown };
  scale: { x: number };
}

/** A `SkinnedMesh`, a `Skeleton`, or the object that contains the bones. */
export type ThreeTarget = { skeleton: { bones: readonly Node3D[] } } | { bones: readonly Node3D[] } | Node3D;

/** A target in its rest pose, bound to the skeleton of a verb. */
export class Binding {
  private readonly nodes: readonly Node3D[];
  private readonly retarget: Retarget;
  private readonly writer: BoneWriter;

  /** @param map names of bones by joints; equal names need no entry, `mixamorig:` and the case do not matter */
  constructor(target: ThreeTarget, skeleton: PoseValues["skeleton"], map: JointMap = {}) {
    this.nodes = nodesOf(target);
    const bones = this.nodes.map((node) => boneOf(node, this.nodes));
    this.retarget = new Retarget(skeleton, bones, map);
    this.writer = {
      rotation: (bone, x, y, z, w) => void this.nodes[bone]?.quaternion.set(x, y, z, w),
      position: (bone, x, y, z) => void this.nodes[bone]?.position.set(x, y, z),
    };
  }

  /** Number of bones that have a joint. */
  get mapped(): number {
    return this.retarget.mapped;
  }

  apply(pose: PoseValues): void {
    this.retarget.apply(pose.values, this.writer);
  }
}

const bindings = new WeakMap<object, { skeleton: object; map: object | undefined; binding: Binding }>();

/**
 * Write a pose to a skeleton. At the first call the target is in its rest pose; another map or verb binds it again.
 *
 * @param jointMap names of bones by the verb's joints; equal names need no entry
 */
export function applyPose(target: ThreeTarget, pose: PoseValues, jointMap?: JointMap): void {
  let known = bindings.get(target);
  if (!known || known.map !== jointMap || !sameJoints(known.skeleton, pose.skeleton)) {
    known = { skeleton: pose.skeleton, map: jointMap, binding: new Binding(target, pose.skeleton, jointMap) };
    bindings.set(target, known);
  }
  known.binding.apply(pose);
}

function sameJoints(a: object, b: PoseValues["skeleton"]): boolean {
  return a === b || (a as PoseValues["skeleton"]).names.join("\n") === b.names.join("\n");
}

/** All nodes from the outermost object on, parents before children. */
function nodesOf(target: ThreeTarget): Node3D[] {
  const bones = "skeleton" in target ? target.skeleton.bones : "bones" in target ? target.bones : null;
  if (!bones) return below(target as Node3D);
  const roots = bones.filter(({ parent }) => !parent || !bones.includes(parent));
  const above = roots[0]?.parent ? ancestors(roots[0].parent) : [];
  return [...above, ...roots.flatMap(below)];
}

function below(node: Node3D): Node3D[] {
  return [node, ...node.children.flatMap(below)];
}

/** Nodes above the bones without the scene: an armature with its scale, which the model has. */
function ancestors(node: Node3D): Node3D[] {
  return node.parent ? [...ancestors(node.parent), node] : [];
}

function boneOf({ name, parent, quaternion: q, position: p, scale }: Node3D, nodes: readonly Node3D[]): TargetBone {
  return {
    name,
    parent: parent ? nodes.indexOf(parent) : -1,
    rotation: [q.x, q.y, q.z, q.w],
    position: [p.x, p.y, p.z],
    scale: scale.x,
  };
}
