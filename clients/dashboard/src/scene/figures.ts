import { DynamicDrawUsage, Group, InstancedMesh, type Material } from "three";
import type { Picture, Skeleton } from "../types";
import { poseLength, type Rig, rigOf, solve, writeMatrix } from "./fk";
import { mannequin } from "./mannequin";
import type { Detail } from "./shapes";
import type { V3 } from "./vec";

/** Offsets between characters of a crowd, sideways and backwards. */
export interface CrowdSpacing {
  readonly side: V3;
  readonly back: V3;
}

/** Offset of character `k` of `count` from the first, written to `out`. */
export function crowdOffset(k: number, count: number, rows: CrowdSpacing, out: Float32Array): void {
  const columns = Math.ceil(Math.sqrt(1.5 * count));
  const [column, row] = [k % columns, Math.floor(k / columns)];
  const side = column % 2 ? (column + 1) / 2 : -column / 2;
  for (let i = 0; i < 3; i++) out[i] = side * (rows.side[i] as number) + row * (rows.back[i] as number);
}

/** Mannequins of one skeleton: one draw call per joint and material for any number of characters. */
export class Figures {
  readonly group = new Group();
  /** Joint positions and rotations of the first character, 3 and 4 per joint. */
  readonly positions: Float32Array;
  readonly rotations: Float32Array;
  readonly rig: Rig;
  count = 0;
  #room = 0;
  #meshes: { joint: number; of: InstancedMesh[] }[] = [];
  #detail: Detail;
  readonly #skeleton: Skeleton;
  readonly #materials: readonly Material[];
  readonly #rows: CrowdSpacing;
  readonly #shift = new Float32Array(3);
  readonly #otherPositions: Float32Array;
  readonly #otherRotations: Float32Array;

  /** @param materials each draws the whole figure once, in this order */
  constructor(skeleton: Skeleton, materials: readonly Material[], rows: CrowdSpacing, detail: Detail) {
    this.rig = rigOf(skeleton);
    this.#skeleton = skeleton;
    this.#materials = materials;
    this.#rows = rows;
    this.#detail = detail;
    const { joints } = this.rig;
    [this.positions, this.#otherPositions] = [new Float32Array(3 * joints), new Float32Array(3 * joints)];
    [this.rotations, this.#otherRotations] = [new Float32Array(4 * joints), new Float32Array(4 * joints)];
  }

  show(picture: Picture | null): void {
    this.count = picture?.count ?? 0;
    this.group.visible = this.count > 0;
    if (!picture || this.count === 0) return;
    if (this.count > this.#room) this.#make(2 ** Math.ceil(Math.log2(this.count)));
    const size = poseLength(this.rig);
    for (let k = this.count - 1; k >= 0; k--) {
      const [positions, rotations] = k
        ? [this.#otherPositions, this.#otherRotations]
        : [this.positions, this.rotations];
      solve(this.rig, picture.poses, k * size, positions, rotations);
      crowdOffset(k, this.count, this.#rows, this.#shift);
      for (const { joint, of } of this.#meshes) {
        writeMatrix(
          positions,
          rotations,
          joint,
          this.#shift,
          (of[0] as InstancedMesh).instanceMatrix.array as Float32Array,
          16 * k,
        );
      }
    }
    for (const { of } of this.#meshes) {
      for (const mesh of of) mesh.count = this.count;
      (of[0] as InstancedMesh).instanceMatrix.needsUpdate = true;
    }
  }

  /** Takes effect with the next picture. */
  setDetail(detail: Detail): void {
    if (detail === this.#detail) return;
    this.#detail = detail;
    this.dispose();
  }

  dispose(): void {
    for (const { of } of this.#meshes) {
      of[0]?.geometry.dispose();
      for (const mesh of of) mesh.dispose();
    }
    this.group.clear();
    this.#meshes = [];
    this.#room = 0;
  }

  #make(room: number): void {
    this.dispose();
    this.#room = room;
    for (const [joint, geometry] of mannequin(this.#skeleton, this.#detail)) {
      const of = this.#materials.map((material, layer) =>
        this.#layer(new InstancedMesh(geometry, material, room), layer),
      );
      const [first, ...rest] = of;
      for (const mesh of rest) mesh.instanceMatrix = (first as InstancedMesh).instanceMatrix;
      this.#meshes.push({ joint, of });
      this.group.add(...of);
    }
  }

  #layer(mesh: InstancedMesh, layer: number): InstancedMesh {
    mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    mesh.frustumCulled = false;
    mesh.castShadow = this.#materials.length === 1;
    mesh.receiveShadow = this.#materials.length === 1;
    mesh.renderOrder = this.#materials.length === 1 ? 0 : 1 + layer;
    return mesh;
  }
}
