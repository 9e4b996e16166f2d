/** Goals of walkers in a crowd that wander, keep apart and stay in an area. */

import type { Axes, Axis } from "./drive/steering";

/** Position and heading of characters, 3 numbers each: x, z (m), heading (rad, from +Z toward +X). */
export type Places = Float32Array;

/** Interval of new goals, ms. */
const EVERY_MS = 100;
/** Characters within this distance are avoided, m; at the shorter one a walker stops behind another. */
const NEAR_M = 1.8;
const STOP_M = 0.7;
/** Room around the first places, m. */
const MARGIN_M = 2;
/** Turn rate per angle to the wanted heading, 1/s, and its limit, rad/s. */
const TURN_RATE = 1.6;
const TURN_RADPS = 1.3;
/** Speeds are spread evenly between these, m/s; every ninth walker jogs. */
const [SLOWEST_MPS, FASTEST_MPS, JOG_MPS] = [0.6, 1.7, 2.3];
const STEP = 0.7548776662466927;

const CELLS = 4096;

/** Characters by cells of the size `NEAR_M`. */
function cellsOf(places: Places, count: number): Map<number, number[]> {
  const cells = new Map<number, number[]>();
  for (let k = 0; k < count; k++) {
    const key = cellAt(places[3 * k] as number, places[3 * k + 1] as number);
    const found = cells.get(key);
    if (found) found.push(k);
    else cells.set(key, [k]);
  }
  return cells;
}

function cellAt(x: number, z: number): number {
  return Math.floor(x / NEAR_M) * CELLS + Math.floor(z / NEAR_M);
}

/** Direction away from near characters, stronger for those ahead, and the free distance ahead, m. */
export function separation(places: Places, k: number, near: readonly number[]): { x: number; z: number; free: number } {
  const [x, z, heading] = places.subarray(3 * k, 3 * k + 3) as unknown as [number, number, number];
  const [fx, fz] = [Math.sin(heading), Math.cos(heading)];
  const out = { x: 0, z: 0, free: NEAR_M };
  for (const other of near) {
    const [dx, dz] = [x - (places[3 * other] as number), z - (places[3 * other + 1] as number)];
    const away = Math.hypot(dx, dz);
    if (other === k || away >= NEAR_M) continue;
    const ahead = away > 1e-6 ? -(dx * fx + dz * fz) / away : 1;
    const push = ((NEAR_M - away) / NEAR_M) * (1 + ahead);
    // Straight ahead, a push backwards would not turn: both walkers pass on the right.
    const [px, pz] = away > 1e-6 ? [dx / away, dz / away] : [-fz, fx];
    const aside = ahead > 0.9 ? 1 : 0;
    out.x += push * (px - aside * fz);
    out.z += push * (pz + aside * fx);
    if (ahead > 0.7) out.free = Math.min(out.free, away);
  }
  return out;
}

export class Walkers {
  /** Adverbs by character, without the first. */
  goals: Record<string, number>[] = [];
  private dueMs = 0;
  private area = { x: 0, z: 0, radius: 0, count: 0 };

  /** Returns whether there were goals. */
  clear(): boolean {
    const had = this.goals.length > 0;
    this.goals = [];
    this.area.count = 0;
    this.dueMs = 0;
    return had;
  }

  /** Compute goals for the displayed places; returns whether they are new. */
  update(axes: Axes, places: Places, count: number, nowMs: number): boolean {
    if (nowMs < this.dueMs) return false;
    this.dueMs = nowMs + EVERY_MS;
    if (count !== this.area.count) this.enclose(places, count);
    const cells = cellsOf(places, count);
    this.goals = Array.from({ length: count - 1 }, (_, k) => this.goal(axes, places, k + 1, cells, nowMs / 1000));
    return true;
  }

  private enclose(places: Places, count: number): void {
    const all = Array.from(
      { length: count },
      (_, k) => [places[3 * k] as number, places[3 * k + 1] as number] as const,
    );
    const [x, z] = [0, 1].map((i) => all.reduce((sum, at) => sum + (at[i] as number), 0) / count) as [number, number];
    const radius = Math.max(...all.map(([px, pz]) => Math.hypot(px - x, pz - z))) + MARGIN_M;
    this.area = { x, z, radius, count };
  }

  private goal(
    axes: Axes,
    places: Places,
    k: number,
    cells: Map<number, number[]>,
    now_s: number,
  ): Record<string, number> {
    const [x, z, heading] = places.subarray(3 * k, 3 * k + 3) as unknown as [number, number, number];
    const near = [-1, 0, 1].flatMap((i) =>
      [-1, 0, 1].flatMap((j) => cells.get(cellAt(x + i * NEAR_M, z + j * NEAR_M)) ?? []),
    );
    const apart = separation(places, k, near);
    const wander = heading + 0.5 * Math.sin(0.4 * now_s + 2.4 * k);
    const out = Math.hypot(x - this.area.x, z - this.area.z);
    const back = Math.max(out - this.area.radius, 0) / Math.max(out, 1e-6);
    const wx = Math.sin(wander) + 1.5 * apart.x - 1.5 * back * (x - this.area.x);
    const wz = Math.cos(wander) + 1.5 * apart.z - 1.5 * back * (z - this.area.z);
    const error = wrap(Math.atan2(wx, wz) - heading);
    const turn = within(TURN_RATE * error, -TURN_RADPS, TURN_RADPS);
    const own = k % 9 === 0 ? JOG_MPS : SLOWEST_MPS + ((k * STEP) % 1) * (FASTEST_MPS - SLOWEST_MPS);
    const speed = own * within((apart.free - STOP_M) / (NEAR_M - STOP_M), 0, 1) * within(Math.cos(error), 0.3, 1);
    const adverb = ({ name, si, min, max }: Axis, value: number) => [name, within(value, min, max) / si];
    return Object.fromEntries([adverb(axes.forward, speed), adverb(axes.turn, turn), adverb(axes.side, 0)]);
  }
}

const within = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);
const wrap = (angle: number): number => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
