import { EdgesGeometry, Vector3 } from "three";
import { ConvexGeometry } from "three/addons/geometries/ConvexGeometry.js";
import type { Verb } from "../types";
import type { Adverbs, ExamplePoint, GoalSpace } from "./goal_space";
import { axesOf } from "./goal_space";
import { add, cross, dot, length, scale, sub, unit, type V3 } from "./vec";

/** Hull mesh in goal space: three points per triangle, two per edge, 3 numbers each. */
export interface Hull {
  readonly faces: Float32Array;
  readonly edges: Float32Array;
}

/** Faces that meet at a smaller angle share no visible edge, degrees. */
const CREASE_DEG = 18;

/** Subdivisions of edges in a curved chart. */
const BENDS = 12;

/** Convex hull of 2D points, counter-clockwise (Andrew's monotone chain). */
export function convexOutline(points: readonly (readonly [number, number])[]): (readonly [number, number])[] {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (all: readonly (readonly [number, number])[]) => {
    const chain: (readonly [number, number])[] = [];
    for (const c of all) {
      for (let [a, b] = chain.slice(-2); a && b; [a, b] = chain.slice(-2)) {
        if ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 1e-12) break;
        chain.pop();
      }
      chain.push(c);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** Convex hull of coplanar points. */
function flat(points: readonly V3[], normal: V3): Hull | null {
  const [right, up] = axesOf(normal);
  const level = points.length ? dot(points[0] as V3, normal) : 0;
  const corners = convexOutline(points.map((p) => [dot(p, right), dot(p, up)] as const));
  if (corners.length < 3) return null;
  const lifted = corners.map(([u, v]) => add(scale(normal, level), add(scale(right, u), scale(up, v))));
  const faces = lifted.slice(2).flatMap((corner, k) => [lifted[0] as V3, lifted[k + 1] as V3, corner]);
  const edges = lifted.flatMap((corner, k) => [corner, lifted[(k + 1) % lifted.length] as V3]);
  return { faces: Float32Array.from(faces.flat()), edges: Float32Array.from(edges.flat()) };
}

/** Whether the points span three dimensions. */
function spans(points: readonly V3[]): boolean {
  const first = points[0];
  if (!first) return false;
  const most = (measure: (p: V3) => number) =>
    points.reduce((best, p) => (Math.abs(measure(p)) > Math.abs(measure(best)) ? p : best), first);
  const second = most((p) => length(sub(p, first)));
  const axis = unit(sub(second, first));
  const third = most((p) => length(cross(sub(p, first), axis)));
  const normal = unit(cross(sub(third, first), axis), [0, 0, 0]);
  const fourth = most((p) => dot(sub(p, first), normal));
  return Math.abs(dot(sub(fourth, first), normal)) > 1e-3 * length(sub(second, first));
}

const vector = (p: V3) => new Vector3(p[0], p[1], p[2]);

/** Triangles and visible edges of the convex hull before curving. */
function solid(points: readonly V3[]): { faces: V3[]; edges: V3[] } {
  const geometry = new ConvexGeometry(points.map(vector));
  const sharp = new EdgesGeometry(geometry, CREASE_DEG);
  const list = (of: { getAttribute(name: "position"): { array: ArrayLike<number>; count: number } }): V3[] => {
    const { array, count } = of.getAttribute("position");
    return Array.from({ length: count }, (_, k) => [array[3 * k], array[3 * k + 1], array[3 * k + 2]] as unknown as V3);
  };
  const result = { faces: list(geometry as never), edges: list(sharp as never) };
  geometry.dispose();
  sharp.dispose();
  return result;
}

/** Subdivide triangles and edges, and map every point. */
function bent(raw: { faces: V3[]; edges: V3[] }, steps: number, move: (p: V3) => V3): Hull {
  const [faces, edges]: [number[], number[]] = [[], []];
  for (let f = 0; f < raw.faces.length; f += 3) {
    const [a, b, c] = raw.faces.slice(f, f + 3) as [V3, V3, V3];
    const corner = (i: number, j: number) =>
      move(add(a, add(scale(sub(b, a), i / steps), scale(sub(c, a), j / steps))));
    for (let i = 0; i < steps; i++) {
      for (let j = 0; j < steps - i; j++) {
        faces.push(...corner(i, j), ...corner(i + 1, j), ...corner(i, j + 1));
        if (i + j < steps - 1) faces.push(...corner(i + 1, j), ...corner(i + 1, j + 1), ...corner(i, j + 1));
      }
    }
  }
  for (let e = 0; e < raw.edges.length; e += 2) {
    const [a, b] = raw.edges.slice(e, e + 2) as [V3, V3];
    for (let i = 0; i < steps; i++) {
      edges.push(...move(add(a, scale(sub(b, a), i / steps))), ...move(add(a, scale(sub(b, a), (i + 1) / steps))));
    }
  }
  return { faces: Float32Array.from(faces), edges: Float32Array.from(edges) };
}

/** The verb's cylindrical chart around the start position: convex when unrolled. */
function cylinder(verb: Verb): { to: (p: V3) => V3; from: (p: V3) => V3 } {
  const [x0, z0, cut, radius] = verb.domain.chart_bend as [number, number, number, number];
  const [a, b, c] = verb.domain.scale as [number, number, number];
  const whole = 2 * Math.PI;
  return {
    to: ([x, y, z]) => {
      const angle = (((Math.atan2(x - x0, z - z0) - cut) % whole) + whole) % whole;
      return [a * radius * angle, b * y, c * Math.hypot(x - x0, z - z0)];
    },
    from: ([u, v, w]) => {
      const angle = u / (a * radius) + cut;
      return [x0 + (w / c) * Math.sin(angle), v / b, z0 + (w / c) * Math.cos(angle)];
    },
  };
}

/** Domain of the verb: the examples' convex hull in the verb's chart. */
export function hullOf(verb: Verb, space: GoalSpace, known: readonly ExamplePoint[]): Hull | null {
  const points = known.map((one) => space.point(one.adverbs));
  if (space.plane) return flat(points, space.plane.normal);
  if (!spans(points)) return null;
  const { chart, chart_axes } = verb.domain;
  if (chart !== "cylinder" || verb.adverbs.length !== 3) return bent(solid(points), 1, (p) => p);
  const names = chart_axes.map((axis) => verb.adverbs[axis]?.name as string);
  const { to, from } = cylinder(verb);
  const numbers = (adverbs: Adverbs) => names.map((name) => adverbs[name]) as unknown as V3;
  const named = (p: V3) => Object.fromEntries(names.map((name, k) => [name, p[k] as number]));
  return bent(solid(known.map((one) => to(numbers(one.adverbs)))), BENDS, (p) => space.point(named(from(p))));
}
