import {
  BufferAttribute,
  BufferGeometry,
  CylinderGeometry,
  ExtrudeGeometry,
  Matrix4,
  Shape,
  SphereGeometry,
  Vector3,
} from "three";
import { mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";
import type { Bar, Loft, Part, Pin, Station } from "./parts";
import { cross, length, sub, unit, type V3 } from "./vec";

export type Detail = "high" | "low" | "simple";

/** Segments of round shapes: around, between two cross-sections, and over an end. */
const FINENESS = {
  high: { around: 20, between: 4, end: 4 },
  low: { around: 8, between: 1, end: 1 },
  simple: { around: 5, between: 1, end: 0 },
} as const;

/** Catmull–Rom curve through `values`, at `t` between `k` and `k + 1`. */
function curve(values: readonly number[], k: number, t: number): number {
  const at = (i: number) => values[Math.min(Math.max(i, 0), values.length - 1)] as number;
  const [a, b, c, d] = [at(k - 1), at(k), at(k + 1), at(k + 2)];
  const bend = 2 * a - 5 * b + 4 * c - d + t * (3 * b - a - 3 * c + d);
  return b + 0.5 * t * (c - a + t * bend);
}

function refined(stations: readonly Station[], steps: number): Station[] {
  const rows = [0, 1, 2, 3, 4].map((row) => stations.map((s) => [...s.at, s.wide, s.deep][row] as number));
  const fine: Station[] = [];
  for (let k = 0; k < stations.length - 1; k++) {
    for (let i = 0; i < steps; i++) {
      const [x, y, z, wide, deep] = rows.map((row) => curve(row, k, i / steps)) as [
        number,
        number,
        number,
        number,
        number,
      ];
      fine.push({ at: [x, y, z], wide, deep });
    }
  }
  return [...fine, stations[stations.length - 1] as Station];
}

/**
 * Close an end with a sphere cap that continues the surface's slope, compressed along the axis.
 *
 * With θ the latitude of equal slope, the cap is r·(1 − sin θ) / cos θ high.
 */
function dome(end: Station, inner: Station, out: V3, rings: number): { stations: Station[]; pole: V3 } {
  const grown = Math.min(inner.wide - end.wide, inner.deep - end.deep);
  const latitude = Math.atan2(Math.max(grown, 0), length(sub(inner.at, end.at)));
  const radius = (0.8 * Math.min(end.wide, end.deep)) / Math.cos(latitude);
  const along = (angle: number): V3 => {
    const rise = radius * (Math.sin(angle) - Math.sin(latitude));
    return [end.at[0] + out[0] * rise, end.at[1] + out[1] * rise, end.at[2] + out[2] * rise];
  };
  const stations = Array.from({ length: rings }, (_, i) => {
    const angle = latitude + ((i + 1) / (rings + 1)) * (Math.PI / 2 - latitude);
    const shrink = Math.cos(angle) / Math.cos(latitude);
    return { at: along(angle), wide: end.wide * shrink, deep: end.deep * shrink };
  });
  return { stations, pole: along(Math.PI / 2) };
}

/** Points of one superellipse cross-section. */
function ring(station: Station, side: V3, front: V3, boxy: number, around: number, out: number[]): void {
  for (let i = 0; i < around; i++) {
    const angle = (2 * Math.PI * i) / around;
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const u = station.wide * Math.sign(c) * Math.abs(c) ** (2 / boxy);
    const v = station.deep * Math.sign(s) * Math.abs(s) ** (2 / boxy);
    for (let k = 0; k < 3; k++) {
      out.push((station.at[k] as number) + u * (side[k] as number) + v * (front[k] as number));
    }
  }
}

function loft(part: Loft, detail: Detail): BufferGeometry {
  const { around, between, end } = FINENESS[detail];
  const stations = refined(part.stations, between);
  const [first, last] = [stations[0] as Station, stations[stations.length - 1] as Station];
  const axis = unit(sub(last.at, first.at));
  const back: V3 = [-axis[0], -axis[1], -axis[2]];
  const bottom = dome(first, stations[1] ?? first, back, end);
  const top = dome(last, stations[stations.length - 2] ?? last, axis, end);
  const all = [...bottom.stations.reverse(), ...stations, ...top.stations];
  const points: number[] = [];
  const front = cross(axis, part.side);
  for (const station of all) ring(station, part.side, front, part.boxy, around, points);
  points.push(...bottom.pole, ...top.pole);
  return closed(points, all.length, around);
}

/** Triangles between consecutive rings, and fans to the two poles. */
function closed(points: number[], rings: number, around: number): BufferGeometry {
  const faces: number[] = [];
  const poles = rings * around;
  for (let i = 0; i < around; i++) {
    const next = (i + 1) % around;
    for (let r = 0; r < rings - 1; r++) {
      const [a, b, c, d] = [r * around + i, r * around + next, (r + 1) * around + i, (r + 1) * around + next];
      faces.push(a, b, d, a, d, c);
    }
    const last = (rings - 1) * around;
    faces.push(poles, next, i, poles + 1, last + i, last + next);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(Float32Array.from(points), 3));
  geometry.setIndex(faces);
  geometry.computeVertexNormals();
  return geometry;
}

/** Transform a shape made along +X (length) and +Z (normal) to its position. */
function laid(geometry: BufferGeometry, along: V3, normal: V3, at: V3): BufferGeometry {
  const vector = (v: V3) => new Vector3(v[0], v[1], v[2]);
  const place = new Matrix4().makeBasis(vector(along), vector(cross(normal, along)), vector(normal));
  geometry.applyMatrix4(place.setPosition(at[0], at[1], at[2]));
  geometry.deleteAttribute("uv");
  return geometry.index ? geometry : mergeVertices(geometry);
}

function bar(part: Bar, detail: Detail): BufferGeometry {
  const direction = sub(part.to, part.from);
  const long = length(direction);
  const lean = Math.acos(Math.min(Math.max((part.radius - part.tip) / long, -1), 1));
  const convexOutline = new Shape();
  convexOutline.absarc(0, 0, part.radius, lean, 2 * Math.PI - lean, false);
  convexOutline.absarc(long, 0, part.tip, -lean, lean, false);
  convexOutline.closePath();
  const bevel = part.thick * 0.16;
  const solid = new ExtrudeGeometry(convexOutline, {
    depth: part.thick - 2 * bevel,
    curveSegments: detail === "high" ? 20 : 6,
    bevelThickness: bevel,
    bevelSize: bevel,
    bevelOffset: -bevel,
    bevelSegments: detail === "high" ? 3 : 1,
  });
  solid.translate(0, 0, bevel - part.thick / 2);
  return laid(solid, unit(direction), part.normal, part.from);
}

function pin(part: Pin, detail: Detail): BufferGeometry {
  const solid = new CylinderGeometry(part.radius, part.radius, part.high, FINENESS[detail].around * 2);
  solid.rotateX(Math.PI / 2);
  const along = unit(cross(part.axis, Math.abs(part.axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0]));
  return laid(solid, along, part.axis, part.at);
}

/** Indexed geometry of one part in its joint's frame, with positions and normals. */
export function shapeOf(part: Part, detail: Detail): BufferGeometry {
  if (part.form === "loft") return loft(part, detail);
  if (part.form === "bar") return bar(part, detail);
  if (part.form === "pin") return pin(part, detail);
  const { around } = FINENESS[detail];
  const ball = new SphereGeometry(part.radius, around, Math.ceil(around * 0.6));
  ball.translate(part.at[0], part.at[1], part.at[2]);
  ball.deleteAttribute("uv");
  return ball;
}
