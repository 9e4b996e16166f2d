/** Poses on skeletons of three.js. Nothing of three.js is imported. */

import { Bindings, type BoneNode, type BoneWriter, type JointMap, type PoseValues, type Rest } from "./retarget.js";

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
  private readonly bound;
  private readonly writer: BoneWriter;

  /** @param map names of bones by joints; equal names need no entry, `mixamorig:` and the case do not matter */
  constructor(target: ThreeTarget, skeleton: PoseValues["skeleton"], map: JointMap = {}) {
    this.bound = new Bindings(bonesOf, restOf).of(target, skeleton, map);
    this.writer = writerOf(this.bound.nodes);
  }

  /** Number of bones that have a joint. */
  get mapped(): number {
    return this.bound.retarget.mapped;
  }

  apply(pose: PoseValues): void {
    this.bound.retarget.apply(pose.values, this.writer);
  }
}

const bindings = new Bindings(bonesOf, restOf);

/**
 * Write a pose to a skeleton. At the first call the target is in its rest pose, which is kept for other maps and verbs.
 *
 * @param jointMap names of bones by the verb's joints; equal names need no entry
 */
export function applyPose(target: ThreeTarget, pose: PoseValues, jointMap?: JointMap): void {
  const { nodes, retarget } = bindings.of(target, pose.skeleton, jointMap);
  retarget.apply(pose.values, writerOf(nodes));
}

function writerOf(nodes: readonly Node3D[]): BoneWriter {
  return {
    rotation: (bone, x, y, z, w) => void nodes[bone]?.quaternion.set(x, y, z, w),
    position: (bone, x, y, z) => void nodes[bone]?.position.set(x, y, z),
  };
}

function bonesOf(target: ThreeTarget): BoneNode<Node3D>[] {
  const nodes = nodesOf(target);
  return nodes.map((node) => ({ node, name: node.name, parent: node.parent ? nodes.indexOf(node.parent) : -1 }));
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

function restOf({ quaternion: q, position: p, scale }: Node3D): Rest {
  return { rotation: [q.x, q.y, q.z, q.w], position: [p.x, p.y, p.z], scale: scale.x };
}
