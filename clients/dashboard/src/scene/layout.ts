import type { Verb } from "../types";
import { type Anatomy, isChain } from "./anatomy";
import type { Frame } from "./camera";
import { hinge } from "./creature";
import type { CrowdSpacing } from "./figures";
import { crowdOffset } from "./figures";
import { add, box, sub, unit, type V3, ZERO } from "./vec";

/** Layout of a verb's characters, ground, light and camera frame. */
export interface Layout {
  /** Whether the motion is planar and vertical, drawn before a wall. */
  readonly wall: boolean;
  /** Z of the wall, m. */
  readonly back: number;
  readonly rows: CrowdSpacing;
  /** Left end of the 1 m bar on the plane. */
  readonly bar: readonly [number, number];
  /** Direction of the key light. */
  readonly light: V3;
  frame(count: number): Frame;
  /** Extent of the grid and radius of the lit area, m. */
  reach(count: number): number;
  radius(count: number): number;
  /** Centre of a crowd relative to its first character. */
  crowd(count: number): { x: number; y: number; z: number };
}

/** Rest positions with the lowest joint at y = 0. */
function atRest(anatomy: Anatomy, wall: boolean): V3[] {
  const tips = anatomy.positions.flatMap((place, j) => (anatomy.tips[j] ?? []).map((tip) => add(place, tip)));
  const all = [...anatomy.positions, ...tips];
  const low = wall ? 0 : Math.min(...all.map((p) => p[1]));
  return all.map((p) => [p[0], p[1] - low, p[2]]);
}

/** Viewing direction: frontal, from the side of the effector. */
function view(anatomy: Anatomy, verb: Verb, wall: boolean): V3 {
  if (wall) return [-0.2, 0.12, 1];
  if (verb.measure.kind === "jump") return [-1, 0.42, 0.8];
  const effector = verb.skeleton.names.indexOf(verb.measure.effector ?? "");
  const left = (anatomy.positions[effector]?.[0] ?? -1) > 0;
  return [left ? 0.72 : -0.72, 0.26, 1];
}

/** Key light from behind the viewer's left shoulder: shadows fall to the visible side. */
function lit(from: V3, wall: boolean): V3 {
  if (wall) return [-0.5, 0.8, 1.6];
  const [x, , z] = unit([from[0], 0, from[2]]);
  return [0.55 * x - 0.75 * z, 1.5, 0.55 * z + 0.75 * x];
}

/** Bounding box of a crowd's offsets, cached by count. */
function spreading(rows: CrowdSpacing): (count: number) => { centre: V3; half: V3 } {
  let known = { count: 1, box: box([ZERO]) };
  return (count) => {
    if (count !== known.count) {
      const at = new Float32Array(3);
      const positions = Array.from({ length: Math.max(count, 1) }, (_, k): V3 => {
        crowdOffset(k, count, rows, at);
        return [at[0] as number, at[1] as number, at[2] as number];
      });
      known = { count, box: box(positions) };
    }
    return known.box;
  };
}

/**
 * @param marked positions of the marks, m
 * @param motion extreme positions of the motion, m
 */
export function layoutOf(anatomy: Anatomy, verb: Verb, marked: readonly V3[], motion: readonly V3[] = []): Layout {
  const wall = isChain(anatomy) && Math.abs(hinge(anatomy)[2]) > 0.9;
  const rest = atRest(anatomy, wall);
  const around: V3[] = wall ? [] : rest.map(([x, y, z]) => [0.55 * x, y, z]);
  const whole = box([...(wall ? rest : around), ...marked]);
  const body = box(rest);
  const extent = 2 * Math.max(...body.half, 0.1);
  const gap = 0.8 * extent;
  const rows: CrowdSpacing = wall
    ? { side: [1.3 * extent, 0, 0], back: [0, 1.1 * extent, 0] }
    : { side: [gap, 0, 0], back: [0, 0, -gap] };
  const spread = spreading(rows);
  const back = wall ? -0.08 * extent : 0;
  const bar = wall
    ? ([whole.centre[0] - 0.5, whole.centre[1] - whole.half[1] - 0.12] as const)
    : ([-0.5, Math.ceil(10 * (whole.half[2] + whole.centre[2] + 0.1)) / 10 + 0.05] as const); // between two grid lines
  const ends = [bar[0], bar[0] + 1].map((u): V3 => (wall ? [u, bar[1], back] : [u, 0, bar[1]]));
  const foot: V3[] = wall ? [[-0.1 * extent, 0, back]] : [];
  const shown = [...(wall ? rest : around), ...foot, ...marked, ...motion, ...ends];
  const from = view(anatomy, verb, wall);
  return {
    wall,
    back,
    rows,
    bar,
    light: lit(from, wall),
    frame: (count) => {
      if (count <= 1) return { points: shown, from };
      const { centre, half } = spread(count);
      return { points: [sub(centre, half), add(centre, half)].flatMap((at) => shown.map((p) => add(p, at))), from };
    },
    reach: (count) => Math.max(6, 4 * extent) + 2 * Math.max(...spread(count).half),
    radius: (count) => 0.95 * extent + Math.max(...spread(count).half) * 1.3,
    crowd: (count) => {
      const [x, y, z] = spread(count).centre;
      return { x, y, z };
    },
  };
}
