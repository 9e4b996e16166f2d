import { heading } from "adverb-client";

/** Smoothing rate of the drawn heading, 1/s; slower than the hip sway of a stride. */
const TURN_RATE = 2.5;

/** Origin of a goal that moves with the character: x, z (m) and heading (rad). */
export class GoalFrame {
  x = 0;
  z = 0;
  heading = 0;
  #phase = -1;
  #startHeading = 0;
  #last: readonly [number, number, number] = [0, 0, 0];

  reset(): void {
    [this.x, this.z, this.heading, this.#phase] = [0, 0, 0, -1];
    [this.#startHeading, this.#last] = [0, [0, 0, 0]];
  }

  /** Origin of a jump: its start. A looped jump that continues from its landing starts there. */
  updateJump(phase: number, root: Float32Array, rotations: Float32Array): void {
    const now = [root[0] as number, root[2] as number, heading(rotations, 0)] as const;
    if (this.#phase < 0) this.#startHeading = phase < 0.05 ? now[2] : 0;
    const near = Math.hypot(now[0] - this.#last[0], now[1] - this.#last[1]) < 0.25;
    if (this.#phase > 0.8 && phase < 0.2) {
      [this.x, this.z, this.heading] = near
        ? [this.#last[0], this.#last[1], this.#last[2] - this.#startHeading]
        : [0, 0, 0];
    }
    [this.#phase, this.#last] = [phase, now];
  }

  /** Origin of a stride: the root's ground position and mean heading. Returns whether the heading is still changing. */
  updateStride(root: Float32Array, rotations: Float32Array, delta_s: number): boolean {
    [this.x, this.z] = [root[0] as number, root[2] as number];
    const whole = 2 * Math.PI;
    const away = heading(rotations, 0) - this.heading;
    const step = away - whole * Math.round(away / whole);
    const first = this.#phase < 0;
    this.#phase = 0;
    this.heading += first ? step : step * (1 - Math.exp(-TURN_RATE * delta_s));
    return !first && Math.abs(step) > 0.01;
  }
}
