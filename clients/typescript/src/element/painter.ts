/** Draws a body on a canvas: rounded limbs, the nearest last, on a ground with a shadow. */

import { solve } from "../math/kinematics.js";
import { rotate } from "../math/quaternion.js";
import type { Body, Limb } from "./body.js";

type Rgb = readonly [number, number, number];

export interface View {
  /** Direction from which the body is seen, rad: from +Z toward +X. */
  yaw: number;
  width: number;
  height: number;
  color: Rgb;
  /** Whether the page is dark. */
  dark: boolean;
}

const TILT = 0.2;
/** Distance of the camera and its focal length, in heights of the body. */
const DISTANCE = 3.6;
const FOCAL = 2.5;
const CELL = 0.5;
const CELLS = 7;

interface Point {
  x: number;
  y: number;
  depth: number;
  /** Pixels per metre. */
  scale: number;
}

export class Painter {
  private readonly joints: Float64Array;
  private readonly rotations: Float64Array;
  private readonly middle: [number, number] = [Number.NaN, 0];

  constructor(
    private readonly context: CanvasRenderingContext2D,
    private readonly body: Body,
  ) {
    const { joints } = body.rig;
    this.joints = new Float64Array(3 * (joints + body.tips.length));
    this.rotations = new Float64Array(4 * joints);
  }

  draw(values: Float32Array, view: View): void {
    this.place(values);
    this.follow(values);
    const { context, body } = this;
    const points = Array.from({ length: this.joints.length / 3 }, (_, k) =>
      this.project(...(this.joints.subarray(3 * k, 3 * k + 3) as unknown as [number, number, number]), view),
    );
    context.clearRect(0, 0, view.width, view.height);
    this.ground(view);
    this.shadow(view);
    const sorted = [...body.limbs].sort((a, b) => depthOf(b, points) - depthOf(a, points));
    for (const limb of sorted) this.limb(limb, points, view);
  }

  /** Joints, then tips. */
  private place(values: Float32Array): void {
    const { rig, tips } = this.body;
    solve(rig, values, 0, this.joints, this.rotations);
    tips.forEach(({ parent, offset }, k) => {
      const at = 3 * (rig.joints + k);
      rotate(this.joints, at, this.rotations, 4 * parent, [...offset], 0);
      for (let a = 0; a < 3; a++)
        this.joints[at + a] = (this.joints[at + a] as number) + (this.joints[3 * parent + a] as number);
    });
  }

  /** The camera follows the root smoothly. */
  private follow(values: Float32Array): void {
    const [x, z] = [values[0] as number, values[2] as number];
    const { middle } = this;
    if (Number.isNaN(middle[0]) || Math.hypot(x - middle[0], z - middle[1]) > 2) [middle[0], middle[1]] = [x, z];
    middle[0] += 0.08 * (x - middle[0]);
    middle[1] += 0.08 * (z - middle[1]);
  }

  private project(x: number, y: number, z: number, { yaw, width, height }: View): Point {
    const { height: size } = this.body;
    const [dx, dz] = [x - this.middle[0], z - this.middle[1]];
    const side = dx * Math.cos(yaw) - dz * Math.sin(yaw);
    const ahead = dx * Math.sin(yaw) + dz * Math.cos(yaw);
    const up = y - this.body.middle;
    const depth = DISTANCE * size - ahead * Math.cos(TILT) - up * Math.sin(TILT);
    const rise = up * Math.cos(TILT) - ahead * Math.sin(TILT);
    const scale = (FOCAL * Math.min(height, 1.3 * width)) / Math.max(depth, 0.2 * size);
    return { x: width / 2 + scale * side, y: height / 2 - scale * rise, depth, scale };
  }

  private ground(view: View): void {
    const { context } = this;
    const extent = CELL * CELLS;
    const [x0, z0] = this.middle.map((value) => Math.round(value / CELL) * CELL) as [number, number];
    context.lineWidth = 1;
    for (let k = -CELLS; k <= CELLS; k++)
      for (const across of [true, false])
        for (let part = -CELLS; part < CELLS; part++) {
          const [a, b] = [part * CELL, (part + 1) * CELL];
          const far = Math.hypot(k * CELL, (a + b) / 2) / extent;
          const strength = 0.22 * Math.max(0, 1 - far) ** 1.5;
          if (strength < 0.01) continue;
          const from = this.project(x0 + (across ? a : k * CELL), 0, z0 + (across ? k * CELL : a), view);
          const to = this.project(x0 + (across ? b : k * CELL), 0, z0 + (across ? k * CELL : b), view);
          context.strokeStyle = view.dark ? `rgba(200,215,240,${strength})` : `rgba(40,60,90,${strength})`;
          context.beginPath();
          context.moveTo(from.x, from.y);
          context.lineTo(to.x, to.y);
          context.stroke();
        }
  }

  /** The limbs on the ground, under light from above on the left; one shape, so that they do not add up. */
  private shadow(view: View): void {
    const { context, body, joints } = this;
    context.save();
    context.globalAlpha = view.dark ? 0.5 : 0.16;
    context.filter = "blur(3px)";
    context.strokeStyle = view.dark ? "#000" : "#101828";
    context.lineCap = "round";
    const cast = (k: number) => {
      const y = joints[3 * k + 1] as number;
      return this.project((joints[3 * k] as number) - 0.22 * y, 0, (joints[3 * k + 2] as number) - 0.12 * y, view);
    };
    const shape = new Path2D();
    let width = 0;
    for (const { from, to, start, end } of body.limbs) {
      const [a, b] = [cast(from), cast(to)];
      shape.moveTo(a.x, a.y);
      shape.lineTo(b.x, b.y);
      width += (a.scale * (start + end)) / body.limbs.length;
    }
    context.lineWidth = width;
    context.stroke(shape);
    context.restore();
  }

  /** A tapered limb with a light and a dark side, and an edge that separates it from those behind. */
  private limb({ from, to, start, end, right }: Limb, points: readonly Point[], view: View): void {
    const [a, b] = [points[from] as Point, points[to] as Point];
    const { context } = this;
    const [ra, rb] = [a.scale * start, b.scale * end];
    const near = (a.depth + b.depth) / 2 / this.body.height - DISTANCE;
    const light = (right ? 0.84 : 1) * (1 - 0.22 * Math.max(-1, Math.min(1, 2 * near)));
    const shape = tapered(a, b, ra, rb);
    const reach = Math.max(ra, rb);
    const [cx, cy] = [(a.x + b.x) / 2, (a.y + b.y) / 2];
    const length = Math.hypot(b.x - a.x, b.y - a.y) / 2 + reach;
    const gradient = context.createLinearGradient(cx - 0.6 * reach, cy - length * 0.6, cx + reach, cy + length * 0.8);
    gradient.addColorStop(0, css(view.color, 1.22 * light));
    gradient.addColorStop(0.5, css(view.color, light));
    gradient.addColorStop(1, css(view.color, 0.66 * light));
    context.fillStyle = gradient;
    context.strokeStyle = css(view.color, 0.45 * light);
    context.lineWidth = Math.max(0.75, 0.1 * Math.min(ra, rb));
    context.stroke(shape);
    context.fill(shape);
  }
}

function depthOf({ from, to }: Limb, points: readonly Point[]): number {
  return ((points[from] as Point).depth + (points[to] as Point).depth) / 2;
}

/** Outline of two circles and what lies between them. */
function tapered(a: Point, b: Point, ra: number, rb: number): Path2D {
  const shape = new Path2D();
  const distance = Math.hypot(b.x - a.x, b.y - a.y);
  if (distance <= Math.abs(ra - rb) + 0.01) {
    const [at, radius] = ra > rb ? [a, ra] : [b, rb];
    shape.arc(at.x, at.y, radius, 0, 2 * Math.PI);
    return shape;
  }
  const along = Math.atan2(b.y - a.y, b.x - a.x);
  const lean = Math.acos((ra - rb) / distance);
  shape.arc(a.x, a.y, ra, along + lean, along - lean);
  shape.arc(b.x, b.y, rb, along - lean, along + lean);
  shape.closePath();
  return shape;
}

function css(color: Rgb, light: number): string {
  return `rgb(${color.map((value) => Math.round(Math.min(255, value * light))).join()})`;
}

/** Red, green, blue of any CSS colour. */
export function rgbOf(context: CanvasRenderingContext2D, color: string): Rgb {
  context.fillStyle = "#4f7fcf";
  context.fillStyle = color;
  const hex = /^#(..)(..)(..)$/.exec(context.fillStyle);
  if (hex) return hex.slice(1).map((part) => Number.parseInt(part, 16)) as unknown as Rgb;
  const numbers = context.fillStyle.match(/[\d.]+/g)?.map(Number) ?? [];
  return [numbers[0] ?? 79, numbers[1] ?? 127, numbers[2] ?? 207];
}
