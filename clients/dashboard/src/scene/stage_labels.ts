import { type Object3D, type PerspectiveCamera, Vector3 } from "three";
import { errorText } from "../units";
import type { ExamplePoint } from "./goal_space";
import { Label } from "./labels";

/** Shorter distances have no label, m. */
const LEAST_M = 0.001;

/** Texts in the scene: distance to the goal, name of a mark, length of the bar. */
export class StageLabels {
  readonly #miss: Label;
  readonly #mark: Label;
  readonly #bar: Label;

  constructor(host: HTMLElement) {
    this.#miss = new Label(host, "chip");
    this.#mark = new Label(host, "chip");
    this.#bar = new Label(host, "plain");
  }

  /** Distance `far` between effector and goal, m; without an effector it is hidden. */
  showMiss(effector: Vector3 | null, goal: Vector3, far: number, camera: PerspectiveCamera): void {
    if (effector && far >= LEAST_M) this.#miss.show(errorText(far), effector.clone().lerp(goal, 0.5), camera, 18);
    else this.#miss.hide();
  }

  showMark(hovered: { known: ExamplePoint; at: Vector3 } | null, camera: PerspectiveCamera): void {
    if (hovered) this.#mark.show(hovered.known.name, hovered.at.clone(), camera, 14);
    else this.#mark.hide();
  }

  showBar(bar: Object3D | null, camera: PerspectiveCamera): void {
    if (bar) this.#bar.show("1 m", bar.localToWorld(new Vector3(1, 0, 0)), camera, 8);
    else this.#bar.hide();
  }

  dispose(): void {
    for (const label of [this.#miss, this.#mark, this.#bar]) label.dispose();
  }
}
