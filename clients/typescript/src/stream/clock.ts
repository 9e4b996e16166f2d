/** Clock offset and message lateness. All times in ms. */

/**
 * Offset of the server's clock by pings. A ping with round trip r gives the offset to within r/2, so the fastest
 * ping of the last minute is used without averaging.
 */
export class Clock {
  private pings: { at: number; roundTrip: number; offset: number }[] = [];

  constructor(private readonly windowMs = 60_000) {}

  add(sentMs: number, arrivedMs: number, serverMs: number): void {
    if (arrivedMs < sentMs) return;
    this.pings.push({ at: arrivedMs, roundTrip: arrivedMs - sentMs, offset: serverMs - (sentMs + arrivedMs) / 2 });
    this.pings = this.pings.filter((ping) => ping.at >= arrivedMs - this.windowMs).slice(-256);
  }

  /** Discard the pings of another server. */
  clear(): void {
    this.pings = [];
  }

  /** Offset from local to server time; NaN before the first ping. */
  get offsetMs(): number {
    return this.best?.offset ?? Number.NaN;
  }

  get roundTripMs(): number {
    return this.best?.roundTrip ?? Number.NaN;
  }

  private get best() {
    return this.pings.reduce<(typeof this.pings)[number] | null>(
      (best, ping) => (best === null || ping.roundTrip <= best.roundTrip ? ping : best),
      null,
    );
  }
}

/**
 * Lateness of messages relative to the fastest one. Transit is arrival minus due time on two clocks; their
 * difference cancels out. The least transit is the ground.
 */
export class Lateness {
  private readonly transits: Float64Array;
  private count = 0;
  private sorted: Float64Array | null = null;

  constructor(window = 256) {
    this.transits = new Float64Array(window);
  }

  add(arrivedMs: number, dueMs: number): void {
    this.transits[this.count++ % this.transits.length] = arrivedMs - dueMs;
    this.sorted = null;
  }

  clear(): void {
    this.count = 0;
    this.sorted = null;
  }

  /** Least transit; NaN before the first message. */
  get groundMs(): number {
    return this.transit(0);
  }

  /** Quantile of the transit above the ground. */
  beyondGroundMs(quantile: number): number {
    return this.transit(quantile) - this.transit(0);
  }

  /** Quantile of the transits, nearest rank from above. */
  transit(quantile: number): number {
    const length = Math.min(this.count, this.transits.length);
    if (length === 0) return Number.NaN;
    this.sorted ??= this.transits.slice(0, length).sort();
    return this.sorted[Math.min(length - 1, Math.ceil(quantile * (length - 1)))] as number;
  }
}
