import {
  Bone,
  BufferGeometry,
  Group,
  MeshStandardMaterial,
  Object3D,
  Quaternion,
  Skeleton,
  SkinnedMesh,
  Texture,
  Vector3,
} from "three";
import { expect, test } from "vitest";
import { POSES, RIGS } from "../../../typescript/src/generated/mapping_vectors";
import type { Verb } from "../types";
import { Model } from "./model";

const [given] = POSES as [(typeof POSES)[number]];
const rig = RIGS.find((each) => each.rig === given.target) as (typeof RIGS)[number];

/** The preset's skeleton as bones of a file: other axes, an armature that is turned and scaled, in centimetres. */
function scene({ unit = 100, roll = true } = {}): Group {
  const armature = new Object3D();
  armature.rotation.x = -Math.PI / 2;
  armature.scale.setScalar(0.1);
  const group = new Group().add(armature);
  group.updateMatrixWorld(true);
  const places: Vector3[] = [];
  const bones = rig.names.map((name, k) => {
    const bone = new Bone();
    bone.name = name;
    const above = rig.parents[k] as number;
    const place = new Vector3(...((k === 0 ? given.origin : given.offsets[k]) as [number, number, number]));
    places.push(above < 0 ? place : place.add(places[above] as Vector3));
    return bone;
  });
  bones.forEach((bone, k) => {
    const parent = bones[rig.parents[k] as number] ?? armature;
    parent.add(bone);
    const turn = roll ? new Quaternion(Math.sin(k), Math.cos(2 * k), 0.3, 0.8).normalize() : new Quaternion();
    bone.quaternion.copy(parent.getWorldQuaternion(new Quaternion()).invert().multiply(turn));
    bone.position.copy(parent.worldToLocal((places[k] as Vector3).clone().multiplyScalar(unit)));
    bone.updateMatrixWorld(true);
  });
  return group;
}

test.each([
  ["metres", { unit: 1, roll: false }],
  ["centimetres and other axes", {}],
])("a figure in %s performs as the library's", (_, options) => {
  const model = new Model(scene(options), {});
  model.bind(given.verb as unknown as Verb, {});
  expect(model.mapper?.scale).toBeCloseTo(given.scale, 4);
  given.values.forEach((values, n) => {
    model.pose(Float32Array.from(values), given.phases[n] as number);
    const places = model.places();
    for (const { target } of model.mapper?.rows ?? []) {
      const wanted = given.places[n]?.[target] as number[];
      const found = places[rig.names[target] as string] as number[];
      expect(Math.hypot(...found.map((value, a) => value - (wanted[a] as number)))).toBeLessThan(0.012);
    }
  });
});

test("another mapping starts from the rest pose", () => {
  const model = new Model(scene(), {});
  const before = model.places();
  model.bind(given.verb as unknown as Verb, {});
  model.pose(Float32Array.from(given.values[2] as number[]), null);
  expect(model.places()).not.toEqual(before);
  model.bind(given.verb as unknown as Verb, { joints: { Neck: "" } });
  const after = model.places();
  for (const [name, place] of Object.entries(before))
    expect(Math.hypot(...place.map((value, a) => value - (after[name]?.[a] ?? 0)))).toBeLessThan(1e-6);
});

test("a file whose nodes do not stand is taken in the pose of its skin", () => {
  const group = scene({ unit: 1 });
  const bones: Bone[] = [];
  group.traverse((node) => (node as Bone).isBone && bones.push(node as Bone));
  const mesh = new SkinnedMesh();
  group.add(mesh);
  mesh.bind(new Skeleton(bones));
  for (const bone of bones)
    if (bone.name.startsWith("thigh")) bone.quaternion.multiply(new Quaternion(1, 0, 0, 1).normalize());
  const model = new Model(group, {});
  model.bind(given.verb as unknown as Verb, {});
  model.pose(Float32Array.from(given.values[2] as number[]), given.phases[2] as number);
  const places = model.places();
  for (const { target } of model.mapper?.rows ?? []) {
    const wanted = given.places[2]?.[target] as number[];
    const found = places[rig.names[target] as string] as number[];
    expect(Math.hypot(...found.map((value, a) => value - (wanted[a] as number)))).toBeLessThan(0.012);
  }
});

test("a figure that is removed keeps nothing on the graphics card", () => {
  const group = scene();
  const bones: Bone[] = [];
  group.traverse((node) => (node as Bone).isBone && bones.push(node as Bone));
  const [map, normalMap] = [new Texture(), new Texture()];
  const material = new MeshStandardMaterial({ map, normalMap });
  const mesh = new SkinnedMesh(new BufferGeometry(), material);
  group.add(mesh);
  mesh.bind(new Skeleton(bones));
  mesh.skeleton.computeBoneTexture();
  const parts = { geometry: mesh.geometry, material, map, normalMap, bones: mesh.skeleton.boneTexture as Texture };
  const disposed: string[] = [];
  for (const [name, part] of Object.entries(parts))
    (part as Texture).addEventListener("dispose", () => disposed.push(name));
  new Model(group, {}).dispose();
  expect(disposed.sort()).toEqual(Object.keys(parts).sort());
});

test("a file without a skeleton is refused", () => {
  expect(() => new Model(new Group(), {})).toThrow(/no skeleton/);
});
