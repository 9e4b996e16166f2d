import type { Anatomy } from "./anatomy";
import { LookAt } from "./look_at";
import type { V3 } from "./vec";

/** Characters look at a neighbour or the camera within these distances, m. */
const NEIGHBOUR_M = 3;
const EYE_M = 12;
/** In each picture, one of this many characters looks for its nearest neighbour. */
const TURNS = 16;
const LONGEST_STEP_S = 0.1;

/** What the characters of a crowd look at: the nearest neighbour or, every second one, the camera. */
export class Attention {
  readonly #look: LookAt;
  /** Nearest neighbour by character; −1: none is near. */
  #nearest: Int32Array = new Int32Array(0);
  #places: Float32Array = new Float32Array(0);
  #count = 0;
  #picture = 0;
  #at_s = 0;
  #step_s = 0;

  constructor(anatomy: Anatomy) {
    this.#look = new LookAt(anatomy);
  }

  /** Start a picture. @param places x, z and heading by character */
  begin(places: Float32Array, count: number, now_s: number): void {
    this.#step_s = Math.min(now_s - this.#at_s, LONGEST_STEP_S);
    [this.#places, this.#count, this.#at_s] = [places, count, now_s];
    this.#look.resize(count);
    if (this.#nearest.length < count) this.#nearest = new Int32Array(2 * count).fill(-1);
    for (let k = this.#picture++ % TURNS; k < count; k += TURNS) this.#nearest[k] = this.#nearestOf(k);
  }

  /**
   * Turn the head of character `k`, whose pose is drawn moved by `shift`.
   *
   * @param eye position of the camera, m
   */
  turn(k: number, positions: Float32Array, rotations: Float32Array, shift: Float32Array, eye: V3): void {
    if (!this.#look.possible) return;
    const target = k % 2 ? this.#neighbour(k, positions) : this.#camera(k, eye);
    const local: V3 | null = target && [target[0] - (shift[0] ?? 0), target[1], target[2] - (shift[2] ?? 0)];
    this.#look.turn(k, positions, rotations, local, this.#step_s);
  }

  #camera(k: number, eye: V3): V3 | null {
    return Math.hypot(eye[0] - this.#place(k, 0), eye[2] - this.#place(k, 1)) < EYE_M ? eye : null;
  }

  /** Head of the nearest neighbour, taken to be as high as the own one. */
  #neighbour(k: number, positions: Float32Array): V3 | null {
    const other = this.#nearest[k] ?? -1;
    if (other < 0 || other >= this.#count) return null;
    return [this.#place(other, 0), this.#look.headHeight(positions), this.#place(other, 1)];
  }

  #nearestOf(k: number): number {
    let [nearest, least] = [-1, NEIGHBOUR_M];
    for (let other = 0; other < this.#count; other++) {
      const away = Math.hypot(this.#place(other, 0) - this.#place(k, 0), this.#place(other, 1) - this.#place(k, 1));
      if (other !== k && away < least) [nearest, least] = [other, away];
    }
    return nearest;
  }

  #place(k: number, axis: 0 | 1): number {
    return this.#places[3 * k + axis] as number;
  }
}
