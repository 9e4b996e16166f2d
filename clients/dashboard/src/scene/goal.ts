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
import { type Adverbs, type GoalSpace, jumpArc, velocityPath } from "./goal_space";
import type { Palette } from "./palette";

/** Radii on screen, pixels: ball, ring, and grab distance for mouse and touch. */
const [BALL_PX, RING_PX, HOLD_PX, HOLD_TOUCH_PX] = [6.5, 13, 16, 26];
const STEPS = 40;

/** The goal handle, the effector marker, and the line between them. */
export class GoalHandle {
  /** In the frame of the verb's goal positions. */
  readonly group = new Group();
  readonly world = new Vector3();
  readonly #ball: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #ghost: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #ring: Mesh<RingGeometry, MeshBasicMaterial>;
  readonly #dot: Mesh<SphereGeometry, MeshBasicMaterial>;
  readonly #miss: Line<BufferGeometry, LineBasicMaterial>;
  readonly #path: Line<BufferGeometry, LineBasicMaterial>;
  readonly #plumb: Line<BufferGeometry, LineBasicMaterial>;
  /** Effector marker and distance line, in world space. */
  readonly effectorGroup = new Group();
  #space: GoalSpace | null = null;

  constructor() {
    const seen = { transparent: true, depthTest: false, depthWrite: false };
    const unit = new SphereGeometry(1, 20, 14);
    this.#ball = new Mesh(unit, new MeshBasicMaterial({ transparent: true, depthWrite: false }));
    this.#ghost = new Mesh(unit, new MeshBasicMaterial({ ...seen, opacity: 0.35 }));
    this.#ring = new Mesh(new RingGeometry(0.88, 1, 40), new MeshBasicMaterial(seen));
    this.#dot = new Mesh(unit, new MeshBasicMaterial(seen));
    this.#miss = line(2, { ...seen });
    this.#path = line(STEPS + 1, { transparent: true });
    this.#plumb = line(2, { transparent: true, opacity: 0.4 });
    for (const [k, mesh] of [this.#ghost, this.#ball, this.#ring].entries()) mesh.renderOrder = 10 + k;
    [this.#miss.renderOrder, this.#dot.renderOrder, this.#path.renderOrder] = [13, 14, 9];
    this.group.add(this.#ghost, this.#ball, this.#ring, this.#path, this.#plumb);
    this.effectorGroup.add(this.#dot, this.#miss);
    this.setSpace(null);
  }

  setSpace(space: GoalSpace | null): void {
    this.#space = space;
    this.group.visible = space !== null;
    this.effectorGroup.visible = false;
    this.#path.visible = space?.movesWithCharacter === true;
    this.#plumb.visible = space?.kind === "space" || space?.kind === "velocity";
  }

  get shown(): boolean {
    return this.#space !== null;
  }

  /** @param names the verb's measured adverbs */
  put(adverbs: Adverbs, names: readonly string[]): void {
    if (!this.#space) return;
    const [x, y, z] = this.#space.point(adverbs);
    for (const mesh of [this.#ball, this.#ghost, this.#ring]) mesh.position.set(x, y, z);
    write(this.#plumb, this.#space.kind === "velocity" ? [0, 0, 0, x, y, z] : [x, y, z, x, 0, z]);
    if (this.#space.kind === "jump") write(this.#path, jumpArc(this.#space, names, adverbs, STEPS));
    if (this.#space.kind === "velocity") write(this.#path, velocityPath(this.#space, names, adverbs, STEPS));
  }

  /** Show the effector, optionally with a line to the goal; null hides it. Returns the distance, m. */
  reach(effector: Vector3 | null, joined: boolean): number {
    this.effectorGroup.visible = effector !== null && this.shown;
    this.#miss.visible = false;
    if (!effector) return 0;
    this.#dot.position.copy(effector);
    const far = effector.distanceTo(this.world);
    this.#miss.visible = joined && far >= 0.001;
    if (this.#miss.visible) write(this.#miss, [...effector.toArray(), ...this.world.toArray()]);
    return far;
  }

  /** Keep the size on screen constant and face the camera; call before each frame. */
  face(camera: PerspectiveCamera, high: number): void {
    this.#ball.getWorldPosition(this.world);
    const metre = pixelsPerMetre(camera, this.world, high);
    this.#ball.scale.setScalar(BALL_PX / metre);
    this.#ghost.scale.setScalar(BALL_PX / metre);
    this.#ring.scale.setScalar(RING_PX / metre);
    this.#dot.scale.setScalar(3 / pixelsPerMetre(camera, this.#dot.position, high));
    this.#ring.parent?.getWorldQuaternion(this.#ring.quaternion).invert().multiply(camera.quaternion);
  }

  /** Whether a pointer position grabs the handle; `to` projects world positions to pixels. */
  hitTest(x: number, y: number, touch: boolean, to: (world: Vector3) => Vector3): boolean {
    if (!this.shown) return false;
    const pixel = to(this.world.clone());
    return pixel.z < 1 && Math.hypot(pixel.x - x, pixel.y - y) <= (touch ? HOLD_TOUCH_PX : HOLD_PX);
  }

  setGrabbed(held: "no" | "near" | "grabbed"): void {
    this.#ring.material.opacity = held === "no" ? 0.75 : 1;
    this.#ball.material.opacity = held === "grabbed" ? 0.85 : 1;
  }

  setPalette(palette: Palette): void {
    for (const mesh of [this.#ball, this.#ghost, this.#ring, this.#path, this.#plumb])
      mesh.material.color.copy(palette.accent);
    for (const mesh of [this.#dot, this.#miss]) mesh.material.color.copy(palette.example);
  }

  dispose(): void {
    for (const mesh of [this.#ball, this.#ghost, this.#ring, this.#dot, this.#miss, this.#path, this.#plumb]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
  }
}

/** Pixels per metre at a world position. */
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
