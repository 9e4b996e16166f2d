import { PerspectiveCamera, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { box, type V3 } from "./vec";

/** What must be in view, and from which side. */
export interface Frame {
  readonly points: readonly V3[];
  /** From their middle toward the eye. */
  readonly from: V3;
}

/** How long the camera rests before it is told, ms. */
const SETTLE_MS = 250;

/** Share of the picture that is filled when framed. */
const FILLED = 0.86;

/** The camera: orbits by hand, follows by itself, tells where it was put. */
export class Eye {
  readonly camera = new PerspectiveCamera(32, 1, 0.05, 200);
  readonly controls: OrbitControls;
  onCamera: (camera: readonly number[]) => void = () => {};
  #frame: Frame = {
    points: [
      [0, 0, 0],
      [0, 1.8, 0],
    ],
    from: [-0.6, 0.3, 1],
  };
  /** Whether nobody moved it since it was framed. */
  #free = true;
  #said: readonly number[] | null = null;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #followed: Vector3 | null = null;
  /** Where the character stands that the frame is about: the frame counts from there. */
  readonly #origin = new Vector3();
  #aside = { right: 0, bottom: 0 };
  #size = { wide: 1, high: 1 };

  constructor(surface: HTMLElement, changed: () => void) {
    this.controls = new OrbitControls(this.camera, surface);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.25, maxDistance: 60 });
    this.controls.maxPolarAngle = 0.53 * Math.PI;
    this.controls.addEventListener("change", () => {
      if (this.#timer !== undefined) this.#tell();
      changed();
    });
    this.controls.addEventListener("start", () => {
      this.#free = false;
      this.#hush();
    });
    this.controls.addEventListener("end", () => this.#tell());
  }

  /** Look at another thing; moves at once unless somebody put the camera where it is. */
  setFrame(frame: Frame): void {
    this.#frame = frame;
    if (this.#free) this.#show();
  }

  /** Where the eye is and what it looks at, 6 numbers. */
  set(camera: readonly number[]): void {
    if (camera.length !== 6 || !camera.every(Number.isFinite)) return;
    if (this.#said && camera.every((value, k) => value === this.#said?.[k])) return;
    this.#free = false;
    this.#said = camera;
    const [x, y, z, tx, ty, tz] = camera as [number, number, number, number, number, number];
    this.camera.position.set(x, y, z);
    this.controls.target.set(tx, ty, tz);
    this.controls.update();
  }

  /** As framed, about a character that stands at a place. */
  reset(origin: Vector3): void {
    this.#free = true;
    this.#said = null;
    this.#followed = null;
    this.#origin.copy(origin);
    this.#hush();
    this.#show();
  }

  resize(wide: number, high: number): void {
    this.#size = { wide, high };
    this.#project();
    if (this.#free) this.#show();
  }

  /** Pixels at the right (negative: left) and below that something else covers: what is looked at moves away. */
  setAside(right: number, bottom: number): void {
    this.#aside = { right, bottom };
    this.#project();
    if (this.#free) this.#show();
  }

  /** Go with a place, a share of the way per frame; null stops. Whether it is still on its way. */
  follow(place: Vector3 | null, delta_s: number): boolean {
    if (!place) {
      this.#followed = null;
      return false;
    }
    this.#followed ??= (this.#free ? this.#origin : place).clone();
    const step = place.clone().sub(this.#followed).setY(0);
    const far = step.length();
    if (far < 5e-4) return false;
    step.multiplyScalar(far > 3 ? 1 : 1 - Math.exp(-6 * delta_s));
    this.#followed.add(step);
    if (this.#free) this.#origin.copy(this.#followed).setY(0);
    this.camera.position.add(step);
    this.controls.target.add(step);
    return true;
  }

  dispose(): void {
    this.#hush();
    this.controls.dispose();
  }

  #project(): void {
    const { wide, high } = this.#size;
    const { right, bottom } = this.#aside;
    this.camera.aspect = wide / high;
    if (right || bottom) this.camera.setViewOffset(wide, high, right / 2, bottom / 2, wide, high);
    else this.camera.clearViewOffset();
    this.camera.updateProjectionMatrix();
  }

  /** Look at the middle of what must be in view, from as near as lets all of it in. */
  #show(): void {
    const { points, from } = this.#frame;
    const { wide, high } = this.#size;
    const target = new Vector3(...box(points).centre);
    const back = new Vector3(...from).normalize();
    const right = new Vector3(0, 1, 0).cross(back).normalize();
    const up = back.clone().cross(right);
    const slope = FILLED * Math.tan((this.camera.fov * Math.PI) / 360);
    const across = (slope * Math.max(wide - Math.abs(this.#aside.right), 1)) / high;
    const along = (slope * Math.max(high - this.#aside.bottom, 1)) / high;
    const at = new Vector3();
    let far = 1;
    for (let k = 0; k < 4; k++) {
      const seen = points.map((point): V3 => {
        at.set(...point).sub(target);
        return [at.dot(right), at.dot(up), at.dot(back)];
      });
      far = Math.max(...seen.map(([x, y, z]) => z + Math.max(Math.abs(x) / across, Math.abs(y) / along)));
      const { centre } = box(seen.map(([x, y, z]): V3 => [x / (far - z), y / (far - z), 0]));
      target.addScaledVector(right, centre[0] * far).addScaledVector(up, centre[1] * far);
    }
    target.add(this.#origin);
    this.camera.position.copy(target).addScaledVector(back, Math.max(far, this.controls.minDistance));
    this.controls.target.copy(target);
    this.controls.update();
  }

  #hush(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
  }

  /** Tell where the camera is, once it has come to rest. */
  #tell(): void {
    this.#hush();
    this.#timer = setTimeout(() => {
      this.#timer = undefined;
      const numbers = [...this.camera.position.toArray(), ...this.controls.target.toArray()];
      this.#said = numbers.map((value) => Math.round(value * 1000) / 1000);
      this.onCamera(this.#said);
    }, SETTLE_MS);
  }
}
