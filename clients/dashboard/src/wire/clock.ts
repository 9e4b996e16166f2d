/** Two clocks: how far the server's is from ours, and how late what it sends comes. All times in ms. */

/**
 * The server's clock by pings. A ping that takes r tells the offset to within r/2, whichever way the time was lost; so
 * the quickest of the last minute is believed, and the others are not averaged in.
 */
export class Clock {
  private pings: { at: number; roundTrip: number; offset: number }[] = [];

  constructor(private readonly windowMs = 60_000) {}

  add(sentMs: number, arrivedMs: number, serverMs: number): void {
    if (arrivedMs < sentMs) return;
    this.pings.push({ at: arrivedMs, roundTrip: arrivedMs - sentMs, offset: serverMs - (sentMs + arrivedMs) / 2 });
    this.pings = this.pings.filter((ping) => ping.at >= arrivedMs - this.windowMs).slice(-256);
  }

  /** Another server has another clock. */
  clear(): void {
    this.pings = [];
  }

  /** What to add to a time of ours to have the server's; NaN before the first ping. */
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
 * How late messages come, against the earliest of them: a message's transit is when it came minus when it was due, on
 * two clocks whose difference nobody needs to know; the least transit is the ground.
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

  /** The least transit; NaN before the first message. */
  get groundMs(): number {
    return this.transit(0);
  }

  /** What all but a share of the messages keep to, past the ground. */
  beyondGroundMs(quantile: number): number {
    return this.transit(quantile) - this.transit(0);
  }

  /** A quantile of the transits, nearest rank from above. */
  transit(quantile: number): number {
    const length = Math.min(this.count, this.transits.length);
    if (length === 0) return Number.NaN;
    this.sorted ??= this.transits.slice(0, length).sort();
    return this.sorted[Math.min(length - 1, Math.ceil(quantile * (length - 1)))] as number;
  }
}
