/**
 * While a goal is moved, the figure is held at the instant that meets it, so that the effector follows the hand; a
 * second after the last move it plays on from there. Where the user has stopped the motion nothing is taken over.
 */

const GO_ON_MS = 1000;

export class Hold {
  /** Where the figure is held; null while it is not. */
  phase: number | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly changed: () => void) {}

  /** The goal moved; `done` when it was let go. */
  move(phase: number | null, done: boolean): void {
    clearTimeout(this.timer);
    if (phase === null) return this.release();
    if (this.phase !== phase) {
      this.phase = phase;
      this.changed();
    }
    if (done) this.timer = setTimeout(() => this.release(), GO_ON_MS);
  }

  release(): void {
    clearTimeout(this.timer);
    if (this.phase === null) return;
    this.phase = null;
    this.changed();
  }
}
