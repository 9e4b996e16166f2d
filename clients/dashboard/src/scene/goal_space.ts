import type { Verb } from "../types";
import { add, cross, dot, length, mean, scale, square, sub, unit, type V3, ZERO } from "./vec";

export type Adverbs = Readonly<Record<string, number>>;

/** An example's adverbs with the measured effector position. */
export interface ExamplePoint {
  readonly name: string;
  readonly adverbs: Adverbs;
  /** Effector position at its keytime, m; null if unknown. */
  readonly point: V3 | null;
}

/** Maps adverbs to positions and back. */
export interface GoalSpace {
  readonly kind: "space" | "sheet" | "jump" | "velocity";
  /** Whether positions are relative to the character instead of the verb's origin. */
  readonly movesWithCharacter: boolean;
  /** SI per unit of adverbs that are not in SI, such as 0.01 for cm. */
  readonly si: Readonly<Record<string, number>>;
  /** Adverbs that dragging changes. */
  readonly names: readonly string[];
  /** Plane of the drag; null: free in space. */
  readonly plane: { readonly normal: V3; readonly through: V3 } | null;
  point(adverbs: Adverbs): V3;
  /** Adverbs of a position; other adverbs are taken from `now`. */
  adverbs(point: V3, now: Adverbs): Record<string, number>;
}

/** Largest residual of an affine map for a draggable goal, m. */
const FIT_M = 0.005;

/** Arrow length per velocity: the distance travelled in this time, s. */
export const AHEAD_S = 0.5;

const value = (adverbs: Adverbs, name: string | undefined): number => adverbs[name ?? ""] ?? 0;

/** SI per unit. */
const SI: Readonly<Record<string, number>> = {
  cm: 0.01,
  mm: 0.001,
  deg: Math.PI / 180,
  "km/h": 1 / 3.6,
  "deg/s": Math.PI / 180,
};

const siOf = (verb: Verb): Record<string, number> =>
  Object.fromEntries(verb.adverbs.map(({ name, unit }) => [name, SI[unit] ?? 1]));

/** Value of an adverb in metres, radians and seconds. */
const inSI = (si: Readonly<Record<string, number>>, adverbs: Adverbs, name: string | undefined): number =>
  value(adverbs, name) * (si[name ?? ""] ?? 1);

/** Affine map from two or three adverbs to positions: origin and one axis per adverb. */
interface AffineMap {
  readonly origin: V3;
  readonly axes: readonly V3[];
}

const at = (map: AffineMap, numbers: readonly number[]): V3 =>
  map.axes.reduce((point, axis, k) => add(point, scale(axis, numbers[k] as number)), map.origin);

/** Solve a·x = b for a symmetric 2×2 or 3×3 matrix by Gaussian elimination; null if singular. */
function solved(a: readonly (readonly number[])[], b: readonly number[]): number[] | null {
  const rows = a.map((row, k) => [...row, b[k] as number]);
  const size = rows.length;
  for (let k = 0; k < size; k++) {
    const pivot = rows.slice(k).reduce((best, row) => (Math.abs(row[k] ?? 0) > Math.abs(best[k] ?? 0) ? row : best));
    rows.splice(rows.indexOf(pivot), 1);
    rows.splice(k, 0, pivot);
    const head = pivot[k] as number;
    if (Math.abs(head) < 1e-9) return null;
    for (let r = 0; r < size; r++) {
      const row = rows[r] as number[];
      const factor = r === k ? 0 : (row[k] as number) / head;
      for (let c = k; c <= size; c++) row[c] = (row[c] as number) - factor * (pivot[c] as number);
    }
  }
  return rows.map((row, k) => (row[size] as number) / (row[k] as number));
}

/** Least-squares affine map of the measured points; null if the residual is too large. */
export function fitAffine(names: readonly string[], known: readonly ExamplePoint[]): AffineMap | null {
  const points = known.filter((one) => one.point !== null);
  if (points.length <= names.length) return null;
  const inputs = points.map((one) => names.map((name) => value(one.adverbs, name)));
  const centre = names.map((_, k) => inputs.reduce((sum, row) => sum + (row[k] as number), 0) / inputs.length);
  const rows = inputs.map((row) => row.map((x, k) => x - (centre[k] as number)));
  const middle = mean(points.map((one) => one.point as V3));
  const normal = names.map((_, i) =>
    names.map((_, j) => rows.reduce((s, r) => s + (r[i] as number) * (r[j] as number), 0)),
  );
  const columns = [0, 1, 2].map((axis) => {
    const side = names.map((_, i) =>
      rows.reduce(
        (s, r, k) => s + (r[i] as number) * ((points[k]?.point?.[axis] as number) - (middle[axis] as number)),
        0,
      ),
    );
    return solved(normal, side);
  });
  if (columns.some((column) => column === null)) return null;
  const axes = names.map((_, k) => columns.map((column) => column?.[k]) as unknown as V3);
  const origin = sub(middle, at({ origin: ZERO, axes }, centre));
  const miss = Math.max(
    ...points.map((one, k) => length(sub(at({ origin, axes }, inputs[k] as number[]), one.point as V3))),
  );
  return miss <= FIT_M ? { origin, axes } : null;
}

/** Fallback without measured points: adverbs named x, y and z are coordinates. */
function named(names: readonly string[]): AffineMap | null {
  const axes: Record<string, V3> = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
  const chosen = names.map((name) => axes[name]);
  return chosen.length > 1 && chosen.every((axis) => axis !== undefined)
    ? { origin: ZERO, axes: chosen as V3[] }
    : null;
}

function affine(names: readonly string[], map: AffineMap): GoalSpace {
  const { axes, origin } = map;
  const normal = axes.length === 2 ? unit(cross(axes[0] as V3, axes[1] as V3), [0, 0, 1]) : null;
  const gram = axes.map((a) => axes.map((b) => dot(a, b)));
  return {
    kind: normal ? "sheet" : "space",
    movesWithCharacter: false,
    si: {},
    names,
    plane: normal ? { normal, through: origin } : null,
    point: (adverbs) =>
      at(
        map,
        names.map((name) => value(adverbs, name)),
      ),
    adverbs: (point, now) => {
      const numbers = solved(
        gram,
        axes.map((axis) => dot(axis, sub(point, origin))),
      );
      return { ...now, ...Object.fromEntries(names.map((name, k) => [name, numbers?.[k] ?? value(now, name)])) };
    },
  };
}

const GROUND = { normal: [0, 1, 0], through: ZERO } as const;

/** Distance, direction (from +Z toward +X) and height: the handle is the landing point, height has a slider only. */
function jump(names: readonly string[], si: Readonly<Record<string, number>>): GoalSpace {
  const [distance, direction] = names as [string, string];
  return {
    kind: "jump",
    movesWithCharacter: true,
    si,
    names: [distance, direction],
    plane: GROUND,
    point: (adverbs) => {
      const [far, angle] = [inSI(si, adverbs, distance), inSI(si, adverbs, direction)];
      return [far * Math.sin(angle), 0, far * Math.cos(angle)];
    },
    adverbs: ([x, , z], now) => {
      const far = Math.hypot(x, z);
      const angle = far > 0.02 ? Math.atan2(x, z) / (si[direction] ?? 1) : value(now, direction);
      return { ...now, [distance]: far / (si[distance] ?? 1), [direction]: angle };
    },
  };
}

/** Forward and sideways speed (left): an arrow on the ground; the turn rate has a slider only. */
function velocity(names: readonly string[], si: Readonly<Record<string, number>>): GoalSpace {
  const [forward, , sideways] = names as [string, string, string];
  return {
    kind: "velocity",
    movesWithCharacter: true,
    si,
    names: [forward, sideways],
    plane: GROUND,
    point: (adverbs) => [inSI(si, adverbs, sideways) * AHEAD_S, 0, inSI(si, adverbs, forward) * AHEAD_S],
    adverbs: ([x, , z], now) => ({
      ...now,
      [forward]: z / AHEAD_S / (si[forward] ?? 1),
      [sideways]: x / AHEAD_S / (si[sideways] ?? 1),
    }),
  };
}

/** Path of a constant velocity and turn rate over `AHEAD_S`, 3 numbers per point. */
export function velocityPath(
  { si }: GoalSpace,
  names: readonly string[],
  adverbs: Adverbs,
  steps: number,
): Float32Array {
  const [forward, turn, sideways] = names.map((name) => inSI(si, adverbs, name)) as [number, number, number];
  const out = new Float32Array(3 * (steps + 1));
  const time = AHEAD_S / steps;
  for (let k = 0; k < steps; k++) {
    const heading = turn * (k + 0.5) * time;
    const [s, c] = [Math.sin(heading), Math.cos(heading)];
    out[3 * k + 3] = (out[3 * k] as number) + (sideways * c + forward * s) * time;
    out[3 * k + 5] = (out[3 * k + 2] as number) + (forward * c - sideways * s) * time;
  }
  return out;
}

/** Arc of a jump from the origin to its landing, 3 numbers per point; `height` is its apex. */
export function jumpArc(space: GoalSpace, names: readonly string[], adverbs: Adverbs, steps: number): Float32Array {
  const [[x, , z], high] = [space.point(adverbs), inSI(space.si, adverbs, names[2])];
  const out = new Float32Array(3 * (steps + 1));
  for (let k = 0; k <= steps; k++) {
    const t = k / steps;
    out.set([x * t, 4 * high * t * (1 - t), z * t], 3 * k);
  }
  return out;
}

const point = (text: readonly number[] | null): V3 | null => (text?.length === 3 ? (text as unknown as V3) : null);

export function examplePoints(verb: Verb): ExamplePoint[] {
  return verb.examples.map((one) => ({ name: one.name, adverbs: one.adverbs, point: point(one.point) }));
}

export function pseudoExamplePoints(verb: Verb): ExamplePoint[] {
  return verb.pseudo_examples.map((one, k) => {
    return { name: `Pseudo-example ${k + 1}`, adverbs: one.adverbs, point: point(one.point) };
  });
}

/** Position map of a verb's measured adverbs; null if they are not positions. */
export function goalSpaceOf(verb: Verb): GoalSpace | null {
  const { kind, adverbs: names } = verb.measure;
  if (kind === "jump" && names.length === 3) return jump(names, siOf(verb));
  if (kind === "root_velocity" && names.length === 3) return velocity(names, siOf(verb));
  if (kind !== "joint_position" || names.length < 2 || names.length > 3) return null;
  const known = examplePoints(verb);
  const map = known.some((one) => one.point) ? fitAffine(names, known) : named(names);
  return map ? affine(names, map) : null;
}

/** Intersection of a ray with a plane; null if parallel or behind the origin. */
export function intersectPlane(from: V3, direction: V3, through: V3, normal: V3): V3 | null {
  const slope = dot(direction, normal);
  if (Math.abs(slope) < 1e-6) return null;
  const far = dot(sub(through, from), normal) / slope;
  return far > 0 ? add(from, scale(direction, far)) : null;
}

/** Two orthonormal axes of a plane. */
export function axesOf(normal: V3): readonly [V3, V3] {
  const right = square(Math.abs(normal[1]) > 0.9 ? [1, 0, 0] : cross([0, 1, 0], normal), normal);
  return [right, cross(normal, right)];
}

/** Clamp adverbs to their ranges plus half a range, which bounds drags toward the horizon. */
export function clampGoal(verb: Verb, adverbs: Record<string, number>): Record<string, number> {
  for (const { name, min, max } of verb.adverbs) {
    const room = 0.5 * (max - min);
    adverbs[name] = Math.min(Math.max(value(adverbs, name), min - room), max + room);
  }
  return adverbs;
}
