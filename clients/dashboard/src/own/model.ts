/** A character of a GLB or VRM file: its joints at rest, and poses written to its bones. */

import { Mapper, type MapperOptions, type RestJoint, Standing } from "adverb-client";
import { type Bone, type Mesh, Object3D, Quaternion, type SkinnedMesh, Texture, Vector3 } from "three";
import type { Verb } from "../types";

/** Height that decides the unit of a file, m; and heights that are plausible in metres. */
const TALL_M = 1.7;
const PLAUSIBLE_M = [0.3, 5] as const;
const UNITS = [1, 0.1, 0.01, 0.001, 0.0254];
/** Share of the height by which the file's zero may lie below its lowest joint and still be the ground. */
const SOLE_SHARE = 0.12;

export class Model {
  readonly object = new Object3D();
  readonly nodes: readonly Object3D[];
  readonly names: readonly string[];
  mapper: Mapper | null = null;
  private joints: RestJoint[];
  private readonly bones: Record<string, number>;
  private readonly ground: number | null;
  private readonly rest: { position: Vector3; quaternion: Quaternion }[];

  /**
   * @param scene of the file
   * @param human nodes of VRM bones that the file names
   */
  constructor(scene: Object3D, human: Readonly<Record<string, Object3D>>) {
    this.object.add(scene);
    scene.traverse((node) => {
      node.frustumCulled = false; // the bounds are those of the rest pose
      if ((node as Mesh).isMesh) node.castShadow = node.receiveShadow = true;
    });
    this.nodes = jointsOf(scene, new Set(Object.values(human)));
    if (this.nodes.length === 0) throw new Error("This file has no skeleton: its meshes have no bones.");
    this.names = unique(this.nodes.map(({ name }) => name));
    this.bones = Object.fromEntries(
      Object.entries(human).flatMap(([bone, node]) => {
        const at = this.nodes.indexOf(node);
        return at < 0 ? [] : [[bone, at]];
      }),
    );
    this.object.scale.setScalar(unitOf(this.nodes));
    this.object.updateMatrixWorld(true);
    this.joints = this.nodes.map((node) => this.restOf(node));
    if (!new Standing(this.joints, this.bones).stands) this.takeBindPose(scene);
    const heights = this.nodes.map((node) => node.getWorldPosition(new Vector3()).y);
    const [low, size] = [Math.min(...heights), Math.max(...heights) - Math.min(...heights)];
    this.rest = this.nodes.map(({ position, quaternion }) => ({
      position: position.clone(),
      quaternion: quaternion.clone(),
    }));
    this.ground = low >= -0.02 * size && low <= SOLE_SHARE * size ? 0 : null;
  }

  /** Prepare the motion of a verb; throws where no joint can be mapped. */
  bind(verb: Verb, options: Pick<MapperOptions, "joints" | "goal">): void {
    this.mapper = null;
    this.mapper = new Mapper(verb, this.joints, { ...options, bones: this.bones, ground: this.ground });
    this.nodes.forEach((node, k) => {
      const { position, quaternion } = this.rest[k] as { position: Vector3; quaternion: Quaternion };
      node.position.copy(position);
      node.quaternion.copy(quaternion);
    });
  }

  /** @param phase null: the effector has no goal */
  pose(values: Float32Array, phase: number | null): void {
    const { mapper } = this;
    if (!mapper) return;
    mapper.apply(values, phase);
    const [turn, above] = [new Quaternion(), new Quaternion()];
    mapper.rows.forEach(({ target }, k) => {
      const node = this.nodes[target] as Object3D;
      const parent = node.parent as Object3D;
      turn.fromArray(mapper.rotations[k] as unknown as number[]);
      node.quaternion.copy(parent.getWorldQuaternion(above).invert().multiply(turn));
      if (k === 0) node.position.copy(parent.worldToLocal(new Vector3(...mapper.root)));
    });
  }

  /** Places of all joints in the scene, by name, metres. */
  places(): Record<string, readonly number[]> {
    return Object.fromEntries(
      this.nodes.map((node, k) => [this.names[k], node.getWorldPosition(new Vector3()).toArray()]),
    );
  }

  dispose(): void {
    this.object.traverse((node) => {
      const { geometry, material, skeleton } = node as Partial<SkinnedMesh>;
      geometry?.dispose();
      skeleton?.dispose();
      for (const each of [material ?? []].flat()) {
        for (const value of Object.values(each)) if (value instanceof Texture) value.dispose();
        each.dispose();
      }
    });
    this.object.removeFromParent();
  }

  /** Take the pose in which the skin was bound, where it stands better than the nodes do. */
  private takeBindPose(scene: Object3D): void {
    const before = this.nodes.map(({ position, quaternion }) => [position.clone(), quaternion.clone()] as const);
    const bound = boundRotations(scene);
    for (const node of this.nodes) {
      const [own, above] = [bound.get(node), bound.get(node.parent as Object3D)];
      if (own && above) node.quaternion.copy(above).invert().multiply(own);
    }
    this.object.updateMatrixWorld(true);
    const joints = this.nodes.map((node) => this.restOf(node));
    if (new Standing(joints, this.bones).stands) {
      this.joints = joints;
      return;
    }
    this.nodes.forEach((node, k) => {
      const [position, quaternion] = before[k] as readonly [Vector3, Quaternion];
      node.position.copy(position);
      node.quaternion.copy(quaternion);
    });
    this.object.updateMatrixWorld(true);
  }

  private restOf(node: Object3D): RestJoint {
    const parent = nearest(node, this.nodes);
    const [place, turn] = [node.getWorldPosition(new Vector3()), node.getWorldQuaternion(new Quaternion())];
    const above = this.nodes[parent];
    if (above) {
      const back = above.getWorldQuaternion(new Quaternion()).invert();
      place.sub(above.getWorldPosition(new Vector3())).applyQuaternion(back);
      turn.premultiply(back);
    }
    const [x, y, z, w] = turn.toArray();
    return {
      name: this.names[this.nodes.indexOf(node)] ?? "",
      parent,
      rotation: [x, y, z, w],
      position: place.toArray(),
    };
  }
}

/** Rotations of the bones in the space in which their skin was bound. */
function boundRotations(scene: Object3D): Map<Object3D, Quaternion> {
  const found = new Map<Object3D, Quaternion>();
  scene.traverse((node) => {
    if (!(node as SkinnedMesh).isSkinnedMesh) return;
    const { bones, boneInverses } = (node as SkinnedMesh).skeleton;
    bones.forEach((bone, k) => {
      const turn = new Quaternion();
      boneInverses[k]?.clone().invert().decompose(new Vector3(), turn, new Vector3());
      found.set(bone, turn);
    });
  });
  return found;
}

/** Bones and the nodes that a VRM file names, parents before children; without any, all plain nodes. */
function jointsOf(scene: Object3D, human: ReadonlySet<Object3D>): Object3D[] {
  const [found, plain]: Object3D[][] = [[], []];
  scene.traverse((node) => {
    if ((node as Bone).isBone || human.has(node)) found?.push(node);
    if (node !== scene && !(node as Mesh).isMesh) plain?.push(node);
  });
  return (found?.length ? found : plain) ?? [];
}

function nearest(node: Object3D, nodes: readonly Object3D[]): number {
  for (let above = node.parent; above; above = above.parent) {
    const at = nodes.indexOf(above);
    if (at >= 0) return at;
  }
  return -1;
}

/** Metres per unit of a file: the unit in which its figure has human size. */
function unitOf(nodes: readonly Object3D[]): number {
  nodes[0]?.updateWorldMatrix(true, true);
  const places = nodes.map((node) => node.getWorldPosition(new Vector3()));
  const span = (axis: "x" | "y" | "z") =>
    Math.max(...places.map((place) => place[axis])) - Math.min(...places.map((place) => place[axis]));
  const size = Math.max(span("x"), span("y"), span("z"));
  if (!(size > 0) || (size >= PLAUSIBLE_M[0] && size <= PLAUSIBLE_M[1])) return 1;
  const far = (unit: number) => Math.abs(Math.log((size * unit) / TALL_M));
  return UNITS.reduce((best, unit) => (far(unit) < far(best) ? unit : best));
}

function unique(names: readonly string[]): string[] {
  const seen = new Set<string>();
  return names.map((name) => {
    let own = name || "joint";
    for (let number = 2; seen.has(own); number++) own = `${name}.${number}`;
    seen.add(own);
    return own;
  });
}
