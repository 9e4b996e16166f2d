/** Scene objects of a draft's clips: paths of the effector with marks at keytimes, and ghost figures. */

import {
  Color,
  CylinderGeometry,
  Group,
  InstancedMesh,
  Matrix4,
  MeshBasicMaterial,
  Quaternion,
  SphereGeometry,
  Vector3,
} from "three";
import { Line2 } from "three/addons/lines/Line2.js";
import { LineGeometry } from "three/addons/lines/LineGeometry.js";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import type { Palette } from "../scene/palette";
import type { Skeleton } from "../types";
import type { ClipFigures, ShownClip } from "./figures";

const BONE_M = 0.005;
const MARK_M = 0.011;
const UP = new Vector3(0, 1, 0);
const WIDTH_PX = { plain: 1.5, selected: 3, excluded: 1 };
const OPACITY = { plain: 0.55, selected: 1, excluded: 0.25 };

type Look = keyof typeof WIDTH_PX;

export class ClipLayer {
  readonly group = new Group();
  readonly #paths = new Group();
  readonly #lines: Record<Look, LineMaterial>;
  readonly #bones: InstancedMesh<CylinderGeometry, MeshBasicMaterial>;
  readonly #marks: InstancedMesh<SphereGeometry, MeshBasicMaterial>;
  readonly #parents: readonly number[];
  #palette: Palette | null = null;

  /**
   * @param effector joint whose path is drawn
   * @param most largest number of clips and of keytimes of each
   */
  constructor(
    private readonly figures: ClipFigures,
    skeleton: Skeleton,
    private readonly effector: number,
    most: { clips: number; keytimes: number },
  ) {
    this.#parents = skeleton.parents;
    const line = (look: Look) =>
      new LineMaterial({ linewidth: WIDTH_PX[look], transparent: true, opacity: OPACITY[look], depthWrite: false });
    this.#lines = { plain: line("plain"), selected: line("selected"), excluded: line("excluded") };
    const bone = new CylinderGeometry(BONE_M, BONE_M, 1, 6, 1, true);
    const glass = new MeshBasicMaterial({ transparent: true, depthWrite: false });
    this.#bones = new InstancedMesh(bone, glass, Math.max(most.clips * skeleton.parents.length, 1));
    const dot = new SphereGeometry(MARK_M, 12, 8);
    this.#marks = new InstancedMesh(dot, new MeshBasicMaterial(), Math.max(most.clips * most.keytimes, 1));
    for (const mesh of [this.#bones, this.#marks]) {
      mesh.frustumCulled = false;
      mesh.count = 0;
    }
    this.group.add(this.#paths, this.#marks, this.#bones);
  }

  /** Draw the paths and the marks of their keytimes; `keytime` is the one at which the effector is measured. */
  showPaths(clips: readonly ShownClip[], keytime: number): void {
    this.#clearPaths();
    let count = 0;
    for (const clip of clips) {
      const motion = this.figures.clips.get(clip.name);
      const [first, last] = [clip.keytimes[0], clip.keytimes.at(-1)];
      if (!motion || first === undefined || last === undefined) continue;
      const look: Look = clip.selected ? "selected" : clip.excluded ? "excluded" : "plain";
      const geometry = new LineGeometry();
      geometry.setPositions(this.figures.path(motion, this.effector, first, last));
      const line = new Line2(geometry, this.#lines[look]);
      line.frustumCulled = false;
      line.renderOrder = clip.selected ? 7 : 6;
      this.#paths.add(line);
      if (!clip.excluded)
        for (const [k, at] of clip.keytimes.entries())
          this.#mark(count++, motion.name, at, k === keytime, clip.selected);
    }
    this.#marks.count = count;
    this.#marks.instanceMatrix.needsUpdate = true;
    if (this.#marks.instanceColor) this.#marks.instanceColor.needsUpdate = true;
  }

  /** Draw the included clips at a phase as ghosts, without the selected one. */
  showGhosts(clips: readonly ShownClip[], phase: number, visible: boolean): void {
    let count = 0;
    const [from, to, turn, matrix] = [new Vector3(), new Vector3(), new Quaternion(), new Matrix4()];
    const [middle, size] = [new Vector3(), new Vector3()];
    for (const clip of visible ? clips : []) {
      const motion = this.figures.clips.get(clip.name);
      if (!motion || clip.excluded || clip.selected) continue;
      const positions = this.figures.positions(motion, clip.time.at(phase));
      for (const [joint, parent] of this.#parents.entries()) {
        if (parent < 0) continue;
        from.fromArray(positions, 3 * parent);
        to.fromArray(positions, 3 * joint);
        const length = from.distanceTo(to);
        if (length < 1e-4) continue;
        middle.addVectors(from, to).multiplyScalar(0.5);
        turn.setFromUnitVectors(UP, to.sub(from).divideScalar(length));
        this.#bones.setMatrixAt(count++, matrix.compose(middle, turn, size.set(1, length, 1)));
      }
    }
    this.#bones.count = count;
    this.#bones.instanceMatrix.needsUpdate = true;
  }

  setVisible(paths: boolean): void {
    this.#paths.visible = this.#marks.visible = paths;
  }

  setPalette(palette: Palette): void {
    this.#palette = palette;
    this.#lines.plain.color.copy(palette.line);
    this.#lines.excluded.color.copy(palette.line);
    this.#lines.selected.color.copy(palette.other);
    this.#bones.material.color.copy(palette.line);
    this.#bones.material.opacity = palette.dark ? 0.34 : 0.3;
  }

  dispose(): void {
    this.#clearPaths();
    for (const material of Object.values(this.#lines)) material.dispose();
    for (const mesh of [this.#bones, this.#marks]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
      mesh.dispose();
    }
    this.group.removeFromParent();
  }

  #mark(index: number, name: string, timeS: number, measured: boolean, selected: boolean): void {
    const motion = this.figures.clips.get(name);
    const palette = this.#palette;
    if (!motion || !palette) return;
    const [x, y, z] = this.figures.point(motion, this.effector, timeS) as unknown as [number, number, number];
    const size = (measured ? 1 : 0.7) * (selected ? 1.5 : 1);
    this.#marks.setMatrixAt(index, new Matrix4().makeScale(size, size, size).setPosition(x, y, z));
    const colour = selected ? palette.other : measured ? palette.accent : palette.line;
    this.#marks.setColorAt(index, new Color().copy(colour));
  }

  #clearPaths(): void {
    for (const line of this.#paths.children) (line as Line2).geometry.dispose();
    this.#paths.clear();
  }
}
