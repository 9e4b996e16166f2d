import { heading, poseLength, type Rig, rigOf, solve, writeMatrix } from "adverb-client";
import { DynamicDrawUsage, Group, InstancedMesh, type Material } from "three";
import type { Picture, Skeleton } from "../types";
import { anatomyOf } from "./anatomy";
import { Attention } from "./attention";
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
  /** Places of all characters in the scene, 3 numbers each: x, z (m), heading (rad). */
  places = new Float32Array(3);
  /** Characters that are updated in every second picture, by slot; null: none. */
  distant: readonly boolean[] | null = null;
  /** Characters nearer to the camera are not drawn, except for the first, m. */
  clearance = 0;
  /** Whether the first character is not drawn. */
  replaced = false;
  readonly #attention: Attention;
  #pictures = 0;
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
    this.#attention = new Attention(anatomyOf(skeleton));
    const { joints } = this.rig;
    [this.positions, this.#otherPositions] = [new Float32Array(3 * joints), new Float32Array(3 * joints)];
    [this.rotations, this.#otherRotations] = [new Float32Array(4 * joints), new Float32Array(4 * joints)];
  }

  /** @param eye position of the camera, which some characters of a crowd look at */
  show(picture: Picture | null, eye: V3): void {
    this.count = picture?.count ?? 0;
    this.group.visible = this.count > 0;
    if (!picture || this.count === 0) return;
    if (this.count > this.#room) this.#make(2 ** Math.ceil(Math.log2(this.count)));
    const size = poseLength(this.rig.joints);
    const half = this.#pictures++ % 2;
    this.#attention.begin(this.places, this.count, performance.now() / 1000);
    for (let k = this.count - 1; k >= 0; k--) {
      if (k > 0 && this.distant?.[k] && k % 2 === half) continue;
      const [positions, rotations] = k
        ? [this.#otherPositions, this.#otherRotations]
        : [this.positions, this.rotations];
      solve(this.rig, picture.poses, k * size, positions, rotations);
      crowdOffset(k, this.count, this.#rows, this.#shift);
      this.places[3 * k] = (positions[0] as number) + (this.#shift[0] as number);
      this.places[3 * k + 1] = (positions[2] as number) + (this.#shift[2] as number);
      this.places[3 * k + 2] = heading(rotations, 0);
      if (k > 0) this.#attention.turn(k, positions, rotations, this.#shift, eye);
      const away = Math.hypot((this.places[3 * k] as number) - eye[0], (this.places[3 * k + 1] as number) - eye[2]);
      const isHidden = k > 0 ? away < this.clearance : this.replaced;
      for (const { joint, of } of this.#meshes) {
        const matrices = (of[0] as InstancedMesh).instanceMatrix.array as Float32Array;
        if (isHidden) matrices.fill(0, 16 * k, 16 * k + 16);
        else writeMatrix(positions, rotations, joint, this.#shift, matrices, 16 * k);
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
    if (this.places.length < 3 * room) {
      const places = new Float32Array(3 * room);
      places.set(this.places);
      this.places = places;
    }
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
