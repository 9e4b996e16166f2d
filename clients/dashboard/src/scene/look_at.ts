import type { Anatomy } from "./anatomy";
import type { V3 } from "./vec";

/** Limits of the head against the chest: to the side and up or down, rad. */
const SIDE = 1;
const UP = 0.35;
/** Targets further to the side are not looked at, rad. */
const BEHIND = 1.9;
/** Rate at which the head follows, 1/s. */
const RATE = 4;

type Quaternion = [number, number, number, number];

/** Turns neck and head of posed figures toward positions. */
export class LookAt {
  /** Joints that turn with the neck, and those that turn with the head. */
  readonly #neck: readonly number[];
  readonly #head: readonly number[];
  readonly #chest: number;
  readonly #forward: V3;
  /** Angles by character: to the side and up, rad. */
  #angles = new Float32Array(0);

  constructor(anatomy: Anatomy) {
    const { regions, parents, forward } = anatomy;
    const below = (top: number) =>
      parents
        .map((_, j) => j)
        .filter((joint) => {
          let at = joint;
          while (at > top) at = parents[at] ?? -1;
          return at === top;
        });
    const head = regions.indexOf("head");
    const neck = head < 0 ? -1 : (parents[head] ?? -1);
    const carriesArms = below(neck).some((joint) => regions[joint] === "upperArm");
    this.#head = head < 0 ? [] : below(head);
    this.#neck = neck < 0 || carriesArms ? [] : below(neck);
    this.#chest = this.#neck.length > 0 ? (parents[neck] ?? -1) : neck;
    this.#forward = forward;
  }

  get possible(): boolean {
    return this.#head.length > 0 && this.#chest >= 0;
  }

  /** Height of the head in a pose, m. */
  headHeight(positions: Float32Array): number {
    return positions[3 * (this.#head[0] as number) + 1] as number;
  }

  /** Make room for a number of characters. */
  resize(characters: number): void {
    if (this.#angles.length >= 2 * characters) return;
    const angles = new Float32Array(4 * characters);
    angles.set(this.#angles);
    this.#angles = angles;
  }

  /**
   * Turn the head of character `k` toward a position; null returns it to its pose.
   *
   * @param positions global joint positions, m; changed
   * @param rotations global joint rotations; changed
   */
  turn(k: number, positions: Float32Array, rotations: Float32Array, target: V3 | null, delta_s: number): void {
    const head = this.#head[0] as number;
    const chest = direction(rotations, this.#chest, this.#forward);
    const face = direction(rotations, head, this.#forward);
    const [side, up] = target ? this.#toward(positions, head, chest, face, target) : [0, 0];
    const share = 1 - Math.exp(-RATE * delta_s);
    const angles = this.#angles.subarray(2 * k, 2 * k + 2);
    angles[0] = (angles[0] as number) + share * (side - (angles[0] as number));
    angles[1] = (angles[1] as number) + share * (up - (angles[1] as number));
    const heading = Math.atan2(face[0], face[2]) + (angles[0] as number);
    const parts = this.#neck.length > 0 ? [this.#neck, this.#head] : [this.#head];
    const half = rotation((angles[0] as number) / parts.length, (angles[1] as number) / parts.length, heading);
    for (const joints of parts) rotate(joints, half, positions, rotations);
  }

  /** Angles from the direction of the face to a target, within the limits against the chest. */
  #toward(positions: Float32Array, head: number, chest: V3, face: V3, target: V3): [number, number] {
    const [x, y, z] = [0, 1, 2].map((i) => (target[i] as number) - (positions[3 * head + i] as number)) as [...V3];
    const ahead = Math.atan2(chest[0], chest[2]);
    const wanted = wrap(Math.atan2(x, z) - ahead);
    if (Math.abs(wanted) > BEHIND) return [0, 0];
    const up = Math.atan2(y, Math.hypot(x, z));
    const now = [wrap(Math.atan2(face[0], face[2]) - ahead), Math.asin(within(face[1], 1))] as const;
    return [within(wanted, SIDE) - within(now[0], SIDE), within(up, UP) - within(now[1], UP)];
  }
}

/** Axis of a joint in the world. */
function direction(rotations: Float32Array, joint: number, axis: V3): V3 {
  return turned(rotations.subarray(4 * joint, 4 * joint + 4) as unknown as Quaternion, axis);
}

function turned([x, y, z, w]: Quaternion, [a, b, c]: V3): V3 {
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
}

/** Rotation about +Y, then upward about the axis across a heading. */
function rotation(side: number, up: number, heading: number): Quaternion {
  const [s, c] = [Math.sin(up / 2), Math.cos(up / 2)];
  return product([-s * Math.cos(heading), 0, s * Math.sin(heading), c], [0, Math.sin(side / 2), 0, Math.cos(side / 2)]);
}

function product([ax, ay, az, aw]: Quaternion, [bx, by, bz, bw]: Quaternion): Quaternion {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** Rotate joints about the first of them. */
function rotate(joints: readonly number[], by: Quaternion, positions: Float32Array, rotations: Float32Array): void {
  const first = 3 * (joints[0] as number);
  const centre = [...positions.subarray(first, first + 3)] as unknown as V3;
  for (const joint of joints) {
    const from = [0, 1, 2].map((i) => (positions[3 * joint + i] as number) - (centre[i] as number)) as unknown as V3;
    const to = turned(by, from);
    for (let i = 0; i < 3; i++) positions[3 * joint + i] = (centre[i] as number) + (to[i] as number);
    rotations.set(product(by, rotations.subarray(4 * joint, 4 * joint + 4) as unknown as Quaternion), 4 * joint);
  }
}

const within = (value: number, most: number): number => Math.min(Math.max(value, -most), most);
const wrap = (angle: number): number => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
