/** Steering of a verb that is measured by the velocity of its root. */

import type { Verb } from "../types";

/** What a player requests, from any device. Each axis is −1 to 1; forward 0.5 walks and 1 runs. */
export interface Steering {
  readonly forward: number;
  /** Positive turns left. */
  readonly turn: number;
  /** Positive steps to the left. */
  readonly side: number;
}

export const STILL: Steering = { forward: 0, turn: 0, side: 0 };

/** Walking and side-stepping speed, m/s, and the share of the greatest speed that a run uses. */
const WALK_MPS = 1.4;
const SIDE_MPS = 0.8;
const RUN_SHARE = 0.85;
/** Greatest acceleration toward the inside of a curve, m/s². */
const INWARD_MPS2 = 3.3;
/** Dead zone of sticks. */
const DEAD = 0.15;

const SI: Readonly<Record<string, number>> = { "km/h": 1 / 3.6, "cm/s": 0.01, "deg/s": Math.PI / 180 };

/** An adverb's name and range in m/s or rad/s. */
export interface Axis {
  readonly name: string;
  /** SI per unit of the adverb. */
  readonly si: number;
  readonly min: number;
  readonly max: number;
}

/** The three measured adverbs of a verb that can be driven. */
export interface Axes {
  readonly forward: Axis;
  readonly turn: Axis;
  readonly side: Axis;
}

/** Axes of a looping verb with forward speed, turn rate and sideways speed; null for other verbs. */
export function axesOf({ adverbs, looping, measure }: Verb): Axes | null {
  if (!looping || measure.kind !== "root_velocity" || measure.adverbs.length !== 3) return null;
  const [forward, turn, side] = measure.adverbs.map((name): Axis | null => {
    const found = adverbs.find((adverb) => adverb.name === name);
    const si = SI[found?.unit ?? ""] ?? 1;
    return found ? { name, si, min: found.min * si, max: found.max * si } : null;
  });
  return forward && turn && side ? { forward, turn, side } : null;
}

/** Forward speed of an axis position, m/s: up to 0.5 a walk, above it a run. */
function speedOf(forward: number, { min, max }: Axis): number {
  if (forward < 0) return Math.max(2 * forward * WALK_MPS, min);
  const walk = Math.min(WALK_MPS, max);
  const run = Math.max(RUN_SHARE * max, walk);
  return forward <= 0.5 ? 2 * forward * walk : walk + (2 * forward - 1) * (run - walk);
}

/** Adverbs for a steering, in their own units and within their ranges. */
export function steer(axes: Axes, { forward, turn, side }: Steering): Record<string, number> {
  const speed = speedOf(within(forward, -1, 1), axes.forward);
  const fastest = INWARD_MPS2 / Math.max(Math.abs(speed), 1e-3);
  const rate = within(within(turn, -1, 1) * (turn > 0 ? axes.turn.max : -axes.turn.min), -fastest, fastest);
  // A run has no room for side steps.
  const across = within(side, -1, 1) * SIDE_MPS * within(2 - Math.abs(speed) / WALK_MPS, 0, 1);
  const adverb = ({ name, si, min, max }: Axis, value: number) => [name, within(value, min, max) / si];
  return Object.fromEntries([adverb(axes.forward, speed), adverb(axes.turn, rate), adverb(axes.side, across)]);
}

/** Position of a stick without its dead zone; the rest is stretched to −1 to 1. */
export function stick(x: number, y: number): [number, number] {
  const size = Math.hypot(x, y);
  if (size <= DEAD) return [0, 0];
  const scale = (Math.min(size, 1) - DEAD) / (1 - DEAD) / size;
  return [x * scale, y * scale];
}

/** Sum of the devices; each axis is limited to −1 to 1. */
export function sum(all: readonly Steering[]): Steering {
  const axis = (key: keyof Steering) =>
    within(
      all.reduce((total, one) => total + one[key], 0),
      -1,
      1,
    );
  return { forward: axis("forward"), turn: axis("turn"), side: axis("side") };
}

function within(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high) + 0; // + 0: no negative zero
}
