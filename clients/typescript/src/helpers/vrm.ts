/** Poses on avatars of @pixiv/three-vrm. Nothing of it is imported. */

import { Bindings, type BoneNode, type JointMap, type PoseValues, type Rest } from "./retarget.js";
import type { Node3D } from "./three.js";

/** The part of three-vrm's `VRM` that is used. */
export interface VrmAvatar {
  humanoid: { getNormalizedBoneNode(name: never): Node3D | null };
  meta?: { metaVersion?: string };
}

/** Bones of VRM by the joints of the built-in verbs' humanoid. */
export const VRM_BONES: JointMap = {
  Hips: "hips",
  Spine: "spine",
  Spine1: "chest",
  Spine2: "upperChest",
  Neck: "neck",
  Head: "head",
  ...sides({
    Shoulder: "Shoulder",
    Arm: "UpperArm",
    ForeArm: "LowerArm",
    Hand: "Hand",
    UpLeg: "UpperLeg",
    Leg: "LowerLeg",
    Foot: "Foot",
    ToeBase: "Toes",
  }),
};

function sides(names: Record<string, string>): Record<string, string> {
  return Object.fromEntries(
    Object.entries(names).flatMap(([joint, bone]) => [
      [`Left${joint}`, `left${bone}`],
      [`Right${joint}`, `right${bone}`],
    ]),
  );
}

const bindings = new Bindings(bonesOf, restOf);

/**
 * Write a pose to the normalized bones of an avatar, which `vrm.update` transfers to the mesh. At the first call the
 * bones are in their rest pose, which is kept for other maps and verbs.
 *
 * @param map names of VRM bones by the verb's joints
 */
export function applyPose(vrm: VrmAvatar, pose: PoseValues, map: JointMap = VRM_BONES): void {
  const { nodes, retarget } = bindings.of(vrm, pose.skeleton, map);
  const sign = signOf(vrm);
  retarget.apply(pose.values, {
    rotation: (bone, x, y, z, w) => void nodes[bone]?.quaternion.set(sign * x, y, sign * z, w),
    position: (bone, x, y, z) => void nodes[bone]?.position.set(sign * x, y, sign * z),
  });
}

/** Avatars of VRM 0 face −Z: they are turned by half a turn about +Y. */
function signOf(vrm: VrmAvatar): number {
  return vrm.meta?.metaVersion === "0" ? -1 : 1;
}

/** Bones of the joints; bones in between that the avatar does not have are left out. */
function bonesOf(vrm: VrmAvatar, skeleton: PoseValues["skeleton"], map: JointMap): BoneNode<Node3D>[] {
  const bones: BoneNode<Node3D>[] = [];
  for (const joint of skeleton.names) {
    const name = map[joint];
    const node = name ? vrm.humanoid.getNormalizedBoneNode(name as never) : null;
    if (!name || !node) continue;
    const nodes = bones.map((bone) => bone.node);
    bones.push({ node, name, parent: nearest(node, nodes) });
  }
  return bones;
}

/** Normalized bones have no rest rotation. */
function restOf({ position: p }: Node3D, vrm: VrmAvatar): Rest {
  const sign = signOf(vrm);
  return { rotation: [0, 0, 0, 1], position: [sign * p.x, p.y, sign * p.z], scale: 1 };
}

/** Index of the nearest node above a node. */
function nearest(node: Node3D, nodes: readonly Node3D[]): number {
  for (let above = node.parent; above; above = above.parent) {
    const at = nodes.indexOf(above);
    if (at >= 0) return at;
  }
  return -1;
}
