/** Levels of detail: each lowers more than the one before. */
export const LEVELS = {
  full: 0,
  /** No shadows, one pixel per CSS pixel. */
  flat: 1,
  /** Fewer segments. */
  coarse: 2,
  /** Bodies without joint balls and fingers. */
  simple: 3,
  /** Distant figures are updated and streamed at half the rate. */
  sparse: 4,
} as const;

/** Mean frame intervals at which detail is lowered and raised; displays of 50 Hz keep full detail. */
const LOWER_MS = 1000 / 48;
const RAISE_MS = 1000 / 49.5;
/** Interval of a decision, and least number of frames in it. */
const WINDOW_MS = 500;
const LEAST_FRAMES = 2;
/** Longer intervals are those of a hidden page, ms. */
const HIDDEN_MS = 5000;
/** Above this mean interval two levels are lowered at once, ms. */
const SLOW_MS = 100;
/** Time at a good rate before detail is raised, ms; doubled each time that raising was too much. */
const WAIT_MS = 4000;
const LONGEST_WAIT_MS = 64_000;

/** Lowers the level of detail before the frame rate falls below 45 per second, and raises it again with hysteresis. */
export class DetailControl {
  level = 0;
  private frames = 0;
  private spentMs = 0;
  private goodMs = 0;
  private sinceRaiseMs = Number.POSITIVE_INFINITY;
  private waitMs = WAIT_MS;

  constructor(private readonly most: number = LEVELS.sparse) {}

  /** Start again at full detail. */
  reset(): void {
    [this.level, this.frames, this.spentMs, this.goodMs] = [0, 0, 0, 0];
    [this.sinceRaiseMs, this.waitMs] = [Number.POSITIVE_INFINITY, WAIT_MS];
  }

  /** Add a frame by the time since the one before, ms; returns whether the level changed. */
  frame(intervalMs: number): boolean {
    if (intervalMs > HIDDEN_MS) return false;
    this.frames++;
    this.spentMs += intervalMs;
    if (this.spentMs < WINDOW_MS || this.frames < LEAST_FRAMES) return false;
    const [meanMs, spentMs] = [this.spentMs / this.frames, this.spentMs];
    [this.frames, this.spentMs] = [0, 0];
    this.sinceRaiseMs += spentMs;
    if (meanMs > LOWER_MS) return this.lower(meanMs > SLOW_MS ? 2 : 1);
    this.goodMs = meanMs < RAISE_MS ? this.goodMs + spentMs : 0;
    return this.level > 0 && this.goodMs >= this.waitMs && this.raise();
  }

  private lower(levels: number): boolean {
    this.goodMs = 0;
    if (this.level >= this.most) return false;
    if (this.sinceRaiseMs < WAIT_MS) this.waitMs = Math.min(2 * this.waitMs, LONGEST_WAIT_MS);
    this.level = Math.min(this.level + levels, this.most);
    return true;
  }

  private raise(): boolean {
    [this.goodMs, this.sinceRaiseMs] = [0, 0];
    this.level--;
    return true;
  }
}

/** Characters further from (x, z) than the middle one of all, by slot; the first is never distant. */
export function distantOf(places: Float32Array, count: number, x: number, z: number): boolean[] {
  const away = Float32Array.from({ length: count }, (_, k) =>
    Math.hypot((places[3 * k] as number) - x, (places[3 * k + 1] as number) - z),
  );
  const middle = away.slice().sort()[Math.floor(count / 2)] as number;
  return Array.from(away, (far, k) => k > 0 && far > middle);
}
