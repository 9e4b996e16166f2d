import { type Anatomy, ends, hangingLength } from "./anatomy";
import type { Part } from "./parts";
import { add, cross, dot, length, lerp, scale, square, sub, unit, type V3, ZERO } from "./vec";

/** Limb radius by the length below it: cross-sections add up (Leonardo's rule for trees). */
function thickness(anatomy: Anatomy): (joint: number | undefined, extra?: number) => number {
  const reach = hangingLength(anatomy);
  const whole = Math.max(...reach, 1e-6);
  const spread = Math.max(...anatomy.positions.map(length), 1e-3);
  return (joint, extra = 0) => {
    const hanging = (joint === undefined ? 0 : (reach[joint] as number)) + extra;
    return spread * (0.012 + 0.085 * Math.sqrt(hanging / whole));
  };
}

/** Trunk where three or more limbs meet: an ellipsoid along the two most distant ends. */
function trunk(anatomy: Anatomy, joint: number): Part[] {
  const all = ends(anatomy, joint);
  if (all.length < 3) return [];
  const pairs = all.flatMap((a, k) => all.slice(k + 1).map((b) => [a, b] as const));
  const [from, to] = pairs.reduce((far, pair) => (apart(pair) > apart(far) ? pair : far));
  const axis = unit(sub(to, from));
  const side = square(anatomy.left, axis);
  const long = apart([from, to]);
  const wide = Math.min(Math.max(...all.map((end) => Math.abs(dot(end, side)))), 0.4 * long) * 1.05 + 0.03 * long;
  const ring = (t: number, share: number) => {
    return { at: lerp(from, to, t), wide: wide * share, deep: wide * share * 0.95 };
  };
  const stations = [ring(0.08, 0.6), ring(0.3, 0.96), ring(0.65, 1), ring(0.94, 0.62)];
  return [{ form: "loft", joint, tone: "body", stations, side, boxy: 2.2 }];
}

const apart = ([a, b]: readonly [V3, V3]): number => length(sub(a, b));

/** Generic body for unknown skeletons: limbs that carry more are thicker. */
export function creatureParts(anatomy: Anatomy): Part[] {
  const radius = thickness(anatomy);
  return anatomy.parents.flatMap((_, joint): Part[] => {
    const limbs = ends(anatomy, joint).map((end, k): Part => {
      const child = anatomy.children[joint]?.[k];
      const near = Math.min(radius(child, length(end)), length(end) * 0.45);
      const far = Math.min(radius(child), near);
      const ring = (t: number, size: number) => ({ at: scale(end, t), wide: size, deep: size });
      const stations = [ring(0.06, near * 0.9), ring(0.3, near), ring(0.94, far * 0.85)];
      return { form: "loft", joint, tone: "body", stations, side: square(anatomy.left, unit(end)), boxy: 2 };
    });
    const body = trunk(anatomy, joint);
    if (body.length) return [...body, ...limbs];
    return [{ form: "ball", joint, tone: "joint", at: ZERO, radius: radius(joint) * 0.8 }, ...limbs];
  });
}

/** Hinge axis of a chain: normal of its bending plane, or +Z if the chain is straight or bends in space. */
export function hinge(anatomy: Anatomy): V3 {
  const steps = anatomy.parents.map((_, j) => ends(anatomy, j)[0]).filter((end) => end !== undefined);
  const first = steps[0] ?? [1, 0, 0];
  const other = steps.find((step) => length(cross(unit(first), unit(step))) > 0.05);
  if (other) return unit(cross(first, other));
  return square([0, 0, 1], unit(first));
}

/** Industrial arm behind the plane of its tip: flat links in two layers, pins, and a wall mount. */
export function armParts(anatomy: Anatomy): Part[] {
  const normal = hinge(anatomy);
  const whole = Math.max(hangingLength(anatomy)[0] as number, 1e-3);
  const thick = 0.024 * whole;
  const last = Math.max(anatomy.parents.length - 1, 1);
  const width = (joint: number) => whole * (0.05 - 0.026 * (joint / last));
  const pin = (joint: number, depth: number, radius: number, high: number): Part => {
    const at = scale(normal, -depth * thick);
    return { form: "pin", joint, tone: "joint", at, axis: normal, radius, high: high * thick };
  };
  const links = anatomy.parents.flatMap((_, joint): Part[] => {
    const end = ends(anatomy, joint)[0];
    if (!end) return [pin(joint, 0.6, 0.4 * width(joint), 1.5)];
    const layer = scale(normal, (joint % 2 ? -0.6 : -1.7) * thick);
    const [radius, tip] = [width(joint), width(joint + 1)];
    const bar: Part = {
      form: "bar",
      joint,
      tone: "body",
      from: layer,
      to: add(end, layer),
      normal,
      radius,
      tip,
      thick,
    };
    return [pin(joint, 1.15, 0.6 * radius, 2.6), bar];
  });
  return [pin(0, 2.7, 0.08 * whole, 0.8), ...links];
}
