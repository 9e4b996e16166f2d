import type { Vector3 } from "three";
import { DetailControl, distantOf, LEVELS } from "./detail_control";
import type { Figures } from "./figures";
import type { Detail } from "./shapes";

/** Interval at which the distant half of a crowd is determined, ms. */
const SORT_MS = 1000;

/** Detail of a crowd, adapted to the frame rate; a single figure keeps the detail that the user chose. */
export class CrowdDetail {
  readonly #control = new DetailControl();
  #sortedMs = 0;
  #drawnMs = performance.now();
  /** A hidden page draws nothing, which is no low frame rate. */
  readonly #visible = () => {
    this.#drawnMs = performance.now();
  };

  constructor() {
    document.addEventListener("visibilitychange", this.#visible);
  }

  get level(): number {
    return this.#control.level;
  }

  /** Call once per drawn frame; returns whether the level changed. */
  adapt(figures: Figures, eye: Vector3, nowMs: number): boolean {
    const before = this.level;
    if (figures.count > 1) this.#control.frame(nowMs - this.#drawnMs);
    else this.#control.reset();
    if (this.level < LEVELS.sparse) figures.distant = null;
    else if (!figures.distant || nowMs > this.#sortedMs + SORT_MS) {
      figures.distant = distantOf(figures.places, figures.count, eye.x, eye.z);
      this.#sortedMs = nowMs;
    }
    this.#drawnMs = nowMs;
    return this.level !== before;
  }

  dispose(): void {
    document.removeEventListener("visibilitychange", this.#visible);
  }

  shapes(chosen: "high" | "low"): Detail {
    if (this.level >= LEVELS.simple) return "simple";
    return chosen === "low" || this.level >= LEVELS.coarse ? "low" : "high";
  }

  hasShadows(chosen: "high" | "low"): boolean {
    return chosen === "high" && this.level < LEVELS.flat;
  }

  pixelRatio(chosen: "high" | "low"): number {
    return Math.min(devicePixelRatio, this.hasShadows(chosen) ? 2 : 1);
  }
}
