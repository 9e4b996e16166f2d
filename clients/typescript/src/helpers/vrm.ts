/** Poses on avatars of @pixiv/three-vrm. Nothing of it is imported. */

import { type JointMap, type PoseValues, Retarget, type TargetBone } from "./retarget.js";
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

interface Bound {
  skeleton: PoseValues["skeleton"];
  map: JointMap;
  nodes: Node3D[];
  retarget: Retarget;
}

const avatars = new WeakMap<VrmAvatar, Bound>();

/**
 * Write a pose to the normalized bones of an avatar; `vrm.update` moves the mesh.
 *
 * @param map names of VRM bones by the verb's joints
 */
export function applyPose(vrm: VrmAvatar, pose: PoseValues, map: JointMap = VRM_BONES): void {
  let bound = avatars.get(vrm);
  if (!bound || bound.map !== map || bound.skeleton !== pose.skeleton) {
    bound = bind(vrm, pose.skeleton, map);
    avatars.set(vrm, bound);
  }
  const { nodes, retarget } = bound;
  const sign = vrm.meta?.metaVersion === "0" ? -1 : 1; // avatars of VRM 0 face −Z: turned by half a turn about +Y
  retarget.apply(pose.values, {
    rotation: (bone, x, y, z, w) => void nodes[bone]?.quaternion.set(sign * x, y, sign * z, w),
    position: (bone, x, y, z) => void nodes[bone]?.position.set(sign * x, y, sign * z),
  });
}

function bind(vrm: VrmAvatar, skeleton: PoseValues["skeleton"], map: JointMap): Bound {
  const sign = vrm.meta?.metaVersion === "0" ? -1 : 1;
  const nodes: Node3D[] = [];
  const bones: TargetBone[] = [];
  for (const joint of skeleton.names) {
    const name = map[joint];
    const node = name ? vrm.humanoid.getNormalizedBoneNode(name as never) : null;
    if (!name || !node) continue;
    const { position: p } = node;
    // normalized bones have no rest rotation; bones in between that the avatar does not have are left out
    const parent = nearest(node, nodes);
    bones.push({ name, parent, rotation: [0, 0, 0, 1], position: [sign * p.x, p.y, sign * p.z], scale: 1 });
    nodes.push(node);
  }
  return { skeleton, map, nodes, retarget: new Retarget(skeleton, bones, map) };
}

/** Index of the nearest node above a node. */
function nearest(node: Node3D, nodes: readonly Node3D[]): number {
  for (let above = node.parent; above; above = above.parent) {
    const at = nodes.indexOf(above);
    if (at >= 0) return at;
  }
  return -1;
}
