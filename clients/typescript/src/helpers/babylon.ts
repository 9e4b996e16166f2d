/**
 * Poses on skeletons of Babylon.js. Nothing of Babylon.js is imported.
 *
 * Models that were loaded from glTF keep their right-handed coordinates below the node `__root__`, in scenes of both
 * kinds.
 */

import { Bindings, type BoneNode, type BoneWriter, type JointMap, type PoseValues, type Rest } from "./retarget.js";

export type { JointMap, PoseValues } from "./retarget.js";

interface Quaternion {
  x: number;
  y: number;
  z: number;
  w: number;
  set(x: number, y: number, z: number, w: number): unknown;
}

/** The part of Babylon's `TransformNode` that is used. */
export interface BabylonNode {
  name: string;
  parent: unknown;
  rotationQuaternion: Quaternion | null;
  rotation: { toQuaternion(): Quaternion };
  position: { x: number; y: number; z: number; set(x: number, y: number, z: number): unknown };
  scaling: { x: number };
  getChildren(): readonly unknown[];
}

/** The node that contains the bones, or a `Skeleton` whose bones have transform nodes. */
export type BabylonTarget = BabylonNode | { bones: readonly { getTransformNode(): unknown }[] };

const ROOT = "__root__";
const bindings = new Bindings(bonesOf, restOf);

/**
 * Write a pose to a skeleton. At the first call the target is in its rest pose, which is kept for other maps and verbs.
 *
 * @param jointMap names of nodes by the verb's joints; equal names need no entry
 */
export function applyPose(target: BabylonTarget, pose: PoseValues, jointMap?: JointMap): void {
  const { nodes, retarget } = bindings.of(target, pose.skeleton, jointMap);
  retarget.apply(pose.values, writerOf(nodes));
}

function writerOf(nodes: readonly BabylonNode[]): BoneWriter {
  return {
    rotation(bone, x, y, z, w) {
      const node = nodes[bone] as BabylonNode;
      node.rotationQuaternion ??= node.rotation.toQuaternion();
      node.rotationQuaternion.set(x, y, z, w);
    },
    position: (bone, x, y, z) => void nodes[bone]?.position.set(x, y, z),
  };
}

/** Nodes below `__root__`, parents before children. */
function nodesOf(target: BabylonTarget): BabylonNode[] {
  if (!("bones" in target)) return below(target);
  const linked = target.bones.flatMap((bone) => (bone.getTransformNode() as BabylonNode | null) ?? []);
  const roots = new Set(linked.map(outermost));
  return [...roots].flatMap(below);
}

function below(node: BabylonNode): BabylonNode[] {
  const children = node.getChildren().filter((child): child is BabylonNode => isNode(child));
  return [...(node.name === ROOT ? [] : [node]), ...children.flatMap(below)];
}

function outermost(node: BabylonNode): BabylonNode {
  const { parent } = node;
  return isNode(parent) && parent.name !== ROOT ? outermost(parent) : node;
}

function isNode(value: unknown): value is BabylonNode {
  return typeof value === "object" && value !== null && "position" in value && "scaling" in value;
}

function bonesOf(target: BabylonTarget): BoneNode<BabylonNode>[] {
  const nodes = nodesOf(target);
  return nodes.map((node) => ({ node, name: node.name, parent: nodes.indexOf(node.parent as BabylonNode) }));
}

function restOf(node: BabylonNode): Rest {
  const { x, y, z, w } = node.rotationQuaternion ?? node.rotation.toQuaternion();
  const { position: p } = node;
  return { rotation: [x, y, z, w], position: [p.x, p.y, p.z], scale: node.scaling.x };
}
