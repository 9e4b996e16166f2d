import type { Anatomy } from "./anatomy";
import { groundHeight, type Slope } from "./slope";

/** A point of a foot that can stand. */
export interface FootPoint {
  readonly joint: number;
  /** Whether the joint stays in place while the foot rolls, so that its movement is a slide. */
  readonly pivot: boolean;
}

/** A foot point stands below this height above its lowest one so far, m, and below this speed, m/s. */
const LOW_M = 0.05;
const SLOW_MPS = 0.2;
/** A standing point leaves at a higher speed, so that noise does not end a stance. */
const LEAVE_MPS = 0.3;
/** Age of a stance at which its position counts as landed, s. */
const LANDED_S = 0.05;
/** Longer pauses between pictures give no speed, s. */
const LONGEST_STEP_S = 0.5;

/** Toes and heels of a skeleton; a foot without a toe joint is one point. */
export function footPoints(anatomy: Anatomy): FootPoint[] {
  const { regions, children, parents } = anatomy;
  return regions.flatMap((region, joint): FootPoint[] => {
    const toes = children[joint]?.some((child) => regions[child] === "toe") === true;
    if (region === "foot") return [{ joint, pivot: !toes }];
    return region === "toe" && regions[parents[joint] ?? -1] === "foot" ? [{ joint, pivot: true }] : [];
  });
}

interface Stance {
  /** Position where it landed, and time of the first contact, s. */
  x: number;
  z: number;
  since: number;
  /** Largest distance from there, m. */
  slide: number;
}

/** Finds standing feet in displayed poses and measures how far they slide. */
export class SlideMeter {
  /** By foot point; null while it does not stand. */
  readonly stances: (Stance | null)[];
  private readonly before: Float32Array;
  private readonly lowest: Float32Array;
  private at = Number.NaN;

  constructor(readonly points: readonly FootPoint[]) {
    this.stances = points.map(() => null);
    this.before = new Float32Array(3 * points.length);
    this.lowest = new Float32Array(points.length).fill(Number.POSITIVE_INFINITY);
  }

  /** Largest slide of the current stances, m; null if no foot stands. */
  get slide(): number | null {
    const slides = this.stances.flatMap((stance, k) => (stance && this.points[k]?.pivot ? [stance.slide] : []));
    return slides.length > 0 ? Math.max(...slides) : null;
  }

  /** @param positions joint positions of one displayed pose, 3 per joint, m */
  update(positions: Float32Array, now_s: number, slope: Slope | null = null): void {
    const step_s = now_s - this.at;
    if (step_s < 1e-3) return;
    this.at = now_s;
    for (const [k, { joint }] of this.points.entries()) {
      const [x, y, z] = positions.subarray(3 * joint, 3 * joint + 3) as unknown as [number, number, number];
      const [bx, by, bz] = this.before.subarray(3 * k, 3 * k + 3) as unknown as [number, number, number];
      this.before.set([x, y, z], 3 * k);
      const speed = step_s < LONGEST_STEP_S ? Math.hypot(x - bx, y - by, z - bz) / step_s : Number.POSITIVE_INFINITY;
      const stance = this.stances[k];
      const height = y - groundHeight(slope, x, z);
      const standing = Math.min(this.lowest[k] as number, height);
      this.lowest[k] = standing;
      if (height - standing >= LOW_M || speed >= (stance ? LEAVE_MPS : SLOW_MPS)) this.stances[k] = null;
      else if (!stance) this.stances[k] = { x, z, since: now_s, slide: 0 };
      else if (now_s - stance.since < LANDED_S) Object.assign(stance, { x, z });
      else stance.slide = Math.max(stance.slide, Math.hypot(x - stance.x, z - stance.z));
    }
  }
}
