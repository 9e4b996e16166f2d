import {
  BufferGeometry,
  Float32BufferAttribute,
  Group,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshBasicMaterial,
  type PerspectiveCamera,
  RingGeometry,
  SphereGeometry,
  Vector3,
} from "three";
import { type Adverbs, arc, type Place, path } from "./goal_space";
import type { Palette } from "./palette";

/** Radii on the screen, pixels: the ball, the ring about it, and where the pointer takes hold. */
const [BALL_PX, RING_PX, HOLD_PX, HOLD_TOUCH_PX] = [6.5, 13, 16, 26];
const STEPS = 40;

/** The goal that is asked for, and the point that is reached, with what joins them. */
export class GoalHandle {
  /** Stands in the frame in which the verb's places are counted. */
  readonly group = new Group();
  readonly world = new Vector3();
  readonly #ball: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #ghost: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #ring: Mesh<RingGeometry, MeshBasicMaterial>;
  readonly #dot: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #miss: Line<BufferGeometry, LineBasicMaterial>;
  readonly #way: Line<BufferGeometry, LineBasicMaterial>;
  readonly #plumb: Line<BufferGeometry, LineBasicMaterial>;
  /** What stands in the world and not in the verb's frame. */
  readonly reached = new Group();
  #place: Place | null = null;

  constructor() {
    const seen = { transparent: true, depthTest: false, depthWrite: false };
    const unit = new SphereGeometry(1, 20, 14);
    this.#ball = new Mesh(unit, new MeshBasicMaterial({ transparent: true, depthWrite: false }));
    this.#ghost = new Mesh(unit, new MeshBasicMaterial({ ...seen, opacity: 0.35 }));
    this.#ring = new Mesh(new RingGeometry(0.88, 1, 40), new MeshBasicMaterial(seen));
    this.#dot = new Mesh(unit, new MeshBasicMaterial(seen));
    this.#miss = line(2, { ...seen });
    this.#way = line(STEPS + 1, { transparent: true });
    this.#plumb = line(2, { transparent: true, opacity: 0.4 });
    for (const [k, mesh] of [this.#ghost, this.#ball, this.#ring].entries()) mesh.renderOrder = 10 + k;
    [this.#miss.renderOrder, this.#dot.renderOrder, this.#way.renderOrder] = [13, 14, 9];
    this.group.add(this.#ghost, this.#ball, this.#ring, this.#way, this.#plumb);
    this.reached.add(this.#dot, this.#miss);
    this.setPlace(null);
  }

  setPlace(place: Place | null): void {
    this.#place = place;
    this.group.visible = place !== null;
    this.reached.visible = false;
    this.#way.visible = place?.carried === true;
    this.#plumb.visible = place?.kind === "space" || place?.kind === "velocity";
  }

  get shown(): boolean {
    return this.#place !== null;
  }

  /** @param names the verb's measured adverbs */
  put(adverbs: Adverbs, names: readonly string[]): void {
    if (!this.#place) return;
    const [x, y, z] = this.#place.point(adverbs);
    for (const mesh of [this.#ball, this.#ghost, this.#ring]) mesh.position.set(x, y, z);
    write(this.#plumb, this.#place.kind === "velocity" ? [0, 0, 0, x, y, z] : [x, y, z, x, 0, z]);
    if (this.#place.kind === "jump") write(this.#way, arc(this.#place, names, adverbs, STEPS));
    if (this.#place.kind === "velocity") write(this.#way, path(names, adverbs, STEPS));
  }

  /** Show where the effector is, joined to the goal if it should be on it; null hides it. Metres between both. */
  reach(effector: Vector3 | null, joined: boolean): number {
    this.reached.visible = effector !== null && this.shown;
    this.#miss.visible = false;
    if (!effector) return 0;
    this.#dot.position.copy(effector);
    const far = effector.distanceTo(this.world);
    this.#miss.visible = joined && far >= 0.001;
    if (this.#miss.visible) write(this.#miss, [...effector.toArray(), ...this.world.toArray()]);
    return far;
  }

  /** Keep the size on the screen, and face the camera; call before each frame. */
  face(camera: PerspectiveCamera, high: number): void {
    this.#ball.getWorldPosition(this.world);
    const metre = pixelsPerMetre(camera, this.world, high);
    this.#ball.scale.setScalar(BALL_PX / metre);
    this.#ghost.scale.setScalar(BALL_PX / metre);
    this.#ring.scale.setScalar(RING_PX / metre);
    this.#dot.scale.setScalar(3 / pixelsPerMetre(camera, this.#dot.position, high));
    this.#ring.parent?.getWorldQuaternion(this.#ring.quaternion).invert().multiply(camera.quaternion);
  }

  /** Whether the pointer takes hold of it; `to` takes world places to pixels. */
  holds(x: number, y: number, touch: boolean, to: (world: Vector3) => Vector3): boolean {
    if (!this.shown) return false;
    const pixel = to(this.world.clone());
    return pixel.z < 1 && Math.hypot(pixel.x - x, pixel.y - y) <= (touch ? HOLD_TOUCH_PX : HOLD_PX);
  }

  setHeld(held: "no" | "near" | "held"): void {
    this.#ring.material.opacity = held === "no" ? 0.75 : 1;
    this.#ball.material.opacity = held === "held" ? 0.85 : 1;
  }

  setPalette(palette: Palette): void {
    for (const mesh of [this.#ball, this.#ghost, this.#ring, this.#way, this.#plumb])
      mesh.material.color.copy(palette.accent);
    for (const mesh of [this.#dot, this.#miss]) mesh.material.color.copy(palette.example);
  }

  dispose(): void {
    for (const mesh of [this.#ball, this.#ghost, this.#ring, this.#dot, this.#miss, this.#way, this.#plumb]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
  }
}

/** How many pixels a metre is at a place of the world. */
export function pixelsPerMetre(camera: PerspectiveCamera, at: Vector3, high: number): number {
  const depth = Math.max(-at.clone().applyMatrix4(camera.matrixWorldInverse).z, camera.near);
  return high / (2 * depth * Math.tan((camera.fov * Math.PI) / 360));
}

function line(points: number, how: object): Line<BufferGeometry, LineBasicMaterial> {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(3 * points, 3));
  const result = new Line(geometry, new LineBasicMaterial(how));
  result.frustumCulled = false;
  return result;
}

function write(of: Line, numbers: ArrayLike<number>): void {
  const points = of.geometry.getAttribute("position");
  (points.array as Float32Array).set(numbers);
  points.needsUpdate = true;
}
