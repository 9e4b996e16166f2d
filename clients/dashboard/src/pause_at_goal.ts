/**
 * Pauses a playing figure at the goal's keytime while the goal is dragged, so that the effector follows the pointer.
 * Playback resumes one second after the last change. A motion paused by the user stays paused.
 */

const GO_ON_MS = 1000;

export class PauseAtGoal {
  /** Phase of the pause; null while not paused. */
  phase: number | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly changed: () => void) {}

  /** The goal changed; `done` at the end of a drag. */
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
