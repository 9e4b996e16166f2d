/** Poses on skeletons of engines: joints are where the verb has them. */

import { readFileSync } from "node:fs";
import { Bone, Euler, Group, Object3D, Quaternion, Skeleton, Vector3 } from "three";
import { beforeAll, describe, expect, test } from "vitest";
import { type EvaluatedPose, Evaluator } from "../evaluator/evaluator.js";
import { applyPose as applyBabylon, type BabylonNode } from "./babylon.js";
import { applyPose, Binding } from "./three.js";
import { applyPose as applyVrm, VRM_BONES } from "./vrm.js";

let evaluator: Evaluator;
let pose: EvaluatedPose;
let expected: Vector3[];

beforeAll(async () => {
  const file = new URL("../../../../verbs/library/reach.verb", import.meta.url);
  evaluator = await Evaluator.load(readFileSync(file));
  pose = evaluator.pose({ x: -0.3, y: 1.2, z: 0.4 }, { phase: 0.5 });
  const flat = evaluator.positions(pose.values);
  expected = pose.skeleton.names.map((_, j) => new Vector3().fromArray([...flat.subarray(3 * j, 3 * j + 3)]));
});

/** Rest positions of the verb's joints relative to the root. */
function positions(): Vector3[] {
  const out: Vector3[] = [];
  pose.skeleton.parents.forEach((parent, j) => {
    const offset = new Vector3().fromArray([...(pose.skeleton.offsets[j] as number[])]);
    out.push(parent < 0 ? offset : offset.add(out[parent] as Vector3));
  });
  return out;
}

/** The verb's skeleton as bones with rest axes, a scale, and a unit of its own. */
function bones(axes: (j: number) => Quaternion, size = 1, name = (joint: string) => joint): Bone[] {
  const rest = positions();
  const all = pose.skeleton.names.map((joint) => Object.assign(new Bone(), { name: name(joint) }));
  pose.skeleton.parents.forEach((parent, j) => {
    const [bone, above] = [all[j] as Bone, all[parent]];
    above?.add(bone);
    const back = above ? axes(parent).invert() : new Quaternion();
    const from = parent < 0 ? new Vector3() : (rest[parent] as Vector3);
    bone.quaternion.copy(back.clone().multiply(axes(j)));
    bone.position.copy((rest[j] as Vector3).clone().sub(from).multiplyScalar(size).applyQuaternion(back));
  });
  const lowest = Math.min(...rest.map(({ y }) => y));
  (all[0] as Bone).position.y = -lowest * size;
  return all;
}

function distances(all: readonly Object3D[], size = 1): number {
  all[0]?.parent?.updateMatrixWorld(true);
  all[0]?.updateMatrixWorld(true);
  const found = all.map((bone) => bone.getWorldPosition(new Vector3()));
  return Math.max(...found.map((point, j) => point.distanceTo((expected[j] as Vector3).clone().multiplyScalar(size))));
}

/** The pose again and again, with another map and another description of the same skeleton each time. */
function repeat(apply: (each: EvaluatedPose, map: Record<string, string>) => void, map: Record<string, string> = {}) {
  for (let k = 0; k < 3; k++) apply({ ...pose, skeleton: structuredClone(pose.skeleton) }, { ...map });
  apply({ ...pose, skeleton: { ...pose.skeleton, names: pose.skeleton.names.map((name) => `${name}_`) } }, map);
  apply(pose, { ...map, unused: "none" });
}

const anyAxes = (j: number) => new Quaternion().setFromEuler(new Euler(j, 2 * j, -0.7 * j));

describe("three.js", () => {
  test("bones with any rest axes have the joints' positions", () => {
    const all = bones(anyAxes);
    applyPose(new Skeleton(all), pose);
    expect(distances(all)).toBeLessThan(1e-5);
  });

  test("names are mapped; prefixes and case do not matter", () => {
    const [mixamo, own] = [
      bones(anyAxes, 1, (joint) => `mixamorig:${joint}`),
      bones(anyAxes, 1, (joint) => `b_${joint}_x`),
    ];
    expect(new Binding(mixamo[0] as Bone, pose.skeleton).mapped).toBe(28);
    expect(new Binding(own[0] as Bone, pose.skeleton).mapped).toBe(0);
    const map = Object.fromEntries(pose.skeleton.names.map((joint) => [joint, `b_${joint}_x`]));
    applyPose(own[0] as Bone, pose, map);
    expect(distances(own)).toBeLessThan(1e-5);
  });

  test("a model in centimetres below an armature that turns and scales", () => {
    const all = bones(anyAxes, 200);
    const [scene, armature] = [new Group(), new Group()];
    scene.add(armature);
    armature.add(all[0] as Bone);
    armature.scale.setScalar(0.01);
    applyPose({ skeleton: { bones: all } }, pose);
    expect(distances(all, 2)).toBeLessThan(1e-4);
  });

  test("the rest pose is that of the first call, also with other maps and verbs", () => {
    const all = bones(anyAxes);
    const skeleton = new Skeleton(all);
    repeat((each, map) => applyPose(skeleton, each, map));
    expect(distances(all)).toBeLessThan(1e-5);
  });

  test("a rest pose with lowered arms reaches the same directions", () => {
    const lowered = new Quaternion().setFromEuler(new Euler(0, 0, -0.8));
    const all = bones(() => new Quaternion());
    const arm = pose.skeleton.names.indexOf("LeftArm");
    (all[arm] as Bone).quaternion.copy(lowered);
    applyPose(all[0] as Bone, pose);
    expect(distances(all)).toBeLessThan(1e-5);
  });
});

describe("VRM", () => {
  const avatar = (version: string) => {
    const rest = positions();
    const sign = version === "0" ? -1 : 1;
    const nodes = new Map<string, Object3D>();
    pose.skeleton.names.forEach((joint, j) => {
      const bone = VRM_BONES[joint];
      if (!bone) return;
      const parent = pose.skeleton.parents[j] as number;
      const node = new Object3D();
      const lowest = Math.min(...rest.map(({ y }) => y));
      const from = parent < 0 ? new Vector3(0, lowest, 0) : (rest[parent] as Vector3);
      node.position.copy((rest[j] as Vector3).clone().sub(from));
      node.position.set(sign * node.position.x, node.position.y, sign * node.position.z);
      nodes.get(VRM_BONES[pose.skeleton.names[parent] as string] ?? "")?.add(node);
      nodes.set(bone, node);
    });
    return {
      humanoid: { getNormalizedBoneNode: (name: string) => nodes.get(name) ?? null },
      meta: { metaVersion: version },
      nodes,
    };
  };

  test.each([
    ["0", "once"],
    ["1", "once"],
    ["0", "repeatedly"],
    ["1", "repeatedly"],
  ])("normalized bones of version %s, posed %s", (version, times) => {
    const vrm = avatar(version);
    if (times === "once") applyVrm(vrm as never, pose);
    else repeat((each, map) => applyVrm(vrm as never, each, map), VRM_BONES);
    const hand = vrm.nodes.get("rightHand")?.getWorldPosition(new Vector3()) as Vector3;
    if (version === "0") hand.set(-hand.x, hand.y, -hand.z);
    const lowest = Math.min(...positions().map(({ y }) => y));
    const feet = Math.min(
      ...["leftToes", "rightToes"]
        .map((name) => pose.skeleton.names.findIndex((joint) => VRM_BONES[joint] === name))
        .map((j) => (positions()[j] as Vector3).y),
    );
    expect(feet).toBeCloseTo(lowest, 6);
    expect(hand.distanceTo(expected[pose.skeleton.names.indexOf("RightHand")] as Vector3)).toBeLessThan(1e-5);
  });
});

/** Nodes with the interface of Babylon's `TransformNode`, on three's objects. */
function babylonNode(object: Object3D, nodes = new Map<Object3D, BabylonNode>()): BabylonNode {
  const known = nodes.get(object);
  if (known) return known;
  const made: BabylonNode = {
    name: object.name,
    get parent() {
      return object.parent ? babylonNode(object.parent, nodes) : null;
    },
    rotationQuaternion: object.quaternion,
    rotation: { toQuaternion: () => new Quaternion() },
    position: object.position,
    scaling: object.scale,
    getChildren: () => object.children.map((child) => babylonNode(child, nodes)),
  };
  nodes.set(object, made);
  return made;
}

test("Babylon.js: nodes below __root__ have the joints' positions", () => {
  const all = bones(anyAxes);
  const root = Object.assign(new Group(), { name: "__root__" });
  root.add(all[0] as Bone);
  root.rotation.y = Math.PI; // as the loader does in left-handed scenes
  applyBabylon(babylonNode(root), pose);
  root.rotation.y = 0;
  expect(distances(all)).toBeLessThan(1e-5);
});

test("Babylon.js: the rest pose is that of the first call, also with other maps and verbs", () => {
  const all = bones(anyAxes);
  const node = babylonNode(all[0] as Bone);
  repeat((each, map) => applyBabylon(node, each, map));
  expect(distances(all)).toBeLessThan(1e-5);
});
