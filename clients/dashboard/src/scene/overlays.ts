import { Vector3 } from "three";
import type { Drawn, Replacement, Verb } from "../types";
import type { CameraRig } from "./camera";
import { figureRect, isOffscreen } from "./figure_rect";
import type { Figures } from "./figures";
import type { GoalHandle } from "./goal";
import type { ExamplePoint } from "./goal_space";
import type { Ground } from "./ground";
import type { Layout } from "./layout";
import type { Lights } from "./light";
import type { SlopedGround } from "./slope";
import { StageLabels } from "./stage_labels";
import type { V3 } from "./vec";

/** Phase tolerance of the keytime for the distance label. */
const AT_KEYTIME = 0.012;
/** Direction of the light in drive mode. */
const DRIVEN_LIGHT: V3 = [0.6, 1.5, -0.7];

/** What overlays depend on in one picture. */
export interface OverlayView {
  readonly rig: CameraRig;
  readonly layout: Layout | null;
  readonly main: Figures | null;
  readonly slope: SlopedGround;
  /** Figure in place of the mannequin. */
  readonly other: Replacement | null;
  readonly driving: boolean;
  readonly following: boolean;
  /** Whether the goal is dragged. */
  readonly dragging: boolean;
}

/** Everything that depends on the camera: light, ground, labels, and where the figure is in the picture. */
export class Overlays {
  /** Phase of the displayed pose. */
  phase = 0;
  /** Mark below the pointer. */
  hovered: { known: ExamplePoint; at: Vector3 } | null = null;
  readonly #host: HTMLElement;
  readonly #labels: StageLabels;
  readonly #ground: Ground;
  readonly #lights: Lights;
  readonly #goal: GoalHandle;
  #effector = -1;
  #keytime = Number.NaN;
  #offscreen = false;

  constructor(host: HTMLElement, parts: { ground: Ground; lights: Lights; goal: GoalHandle }) {
    this.#host = host;
    this.#labels = new StageLabels(host);
    this.#ground = parts.ground;
    this.#lights = parts.lights;
    this.#goal = parts.goal;
  }

  /** Whether no part of the figure is in the picture. */
  get offscreen(): boolean {
    return this.#offscreen;
  }

  /** Effector and keytime of a verb. */
  describe({ measure, skeleton, keytime_names: names, keytime_phases: phases }: Verb): void {
    this.hovered = null;
    this.#effector = measure.effector ? skeleton.names.indexOf(measure.effector) : -1;
    this.#keytime = phases[names.indexOf(measure.keytime ?? "")] ?? Number.NaN;
  }

  /** Update before a picture, and write what is drawn; returns whether the figure is off screen. */
  update(view: OverlayView, drawn: Drawn): boolean {
    const { camera } = view.rig;
    camera.updateMatrixWorld();
    this.#goal.face(camera, this.#host.clientHeight);
    if (view.layout) this.#place(view, view.layout);
    this.#locateFigure(view, drawn);
    this.#updateLabels(view, drawn);
    return this.#offscreen;
  }

  dispose(): void {
    this.#labels.dispose();
  }

  /** Light and ground below the figure, or below the centre of the view. */
  #place({ rig, main, slope, other, driving, following }: OverlayView, layout: Layout): void {
    const { target } = rig.controls;
    const count = main?.count ?? 1;
    const travel = other?.travel ?? 1;
    const [x, y, z] = main?.count
      ? [...main.positions.subarray(0, 3)].map((value) => travel * value)
      : [target.x, target.y, target.z];
    const snap = (value: number | undefined) => Math.round((value ?? 0) * 4) / 4;
    const crowd = layout.crowd(count);
    const light = driving ? DRIVEN_LIGHT : layout.light;
    this.#lights.aim(snap(x) + crowd.x, snap(y) + crowd.y, snap(z) + crowd.z, layout.radius(count), light);
    this.#ground.tilt(slope);
    this.#ground.centre(target.x, target.y, target.z);
    const [u, v] = (following || driving) && main?.count ? [Math.round(x ?? 0), Math.round(z ?? 0)] : [0, 0];
    this.#ground.putBar(layout.bar[0] + u, layout.bar[1] + v);
  }

  #locateFigure({ rig, main, other }: OverlayView, drawn: Drawn): void {
    const { clientWidth: wide, clientHeight: high } = this.#host;
    if (!main?.count) return;
    const travel = other?.travel ?? 1;
    const positions = travel === 1 ? main.positions : main.positions.map((value) => travel * value);
    drawn.figure = figureRect(positions, rig.camera, wide, high);
    this.#offscreen = isOffscreen(drawn.figure, wide, high);
  }

  #updateLabels({ rig, main, other, driving, dragging }: OverlayView, drawn: Drawn): void {
    const { camera } = rig;
    const at = this.#effector >= 0 && main?.count ? new Vector3().fromArray(main.positions, 3 * this.#effector) : null;
    const own = other?.effector();
    if (at && own) at.set(...own);
    drawn.effector = at?.toArray() ?? null;
    const judged = Math.abs(this.phase - this.#keytime) < AT_KEYTIME;
    const far = this.#goal.reach(at, judged);
    this.#labels.showMiss(judged && this.#goal.shown ? at : null, this.#goal.world, far, camera);
    this.#labels.showMark(dragging || driving ? null : this.hovered, camera);
    this.#ground.group.updateMatrixWorld(true);
    this.#labels.showBar(driving ? null : this.#ground.bar, camera);
  }
}
