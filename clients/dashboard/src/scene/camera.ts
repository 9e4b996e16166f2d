import { PerspectiveCamera, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { box, type V3 } from "./vec";

/** Points to keep in view, and the viewing direction. */
export interface Frame {
  readonly points: readonly V3[];
  /** Direction from their centre to the camera. */
  readonly from: V3;
}

/** Delay before a camera change is reported, ms. */
const SETTLE_MS = 250;

/** Fraction of the picture filled by the frame. */
const FILLED = 0.86;

/** Camera behind a driven character: distance, height of camera and of target, m, and angle from straight behind, rad. */
const BEHIND = { distance: 6.2, height: 2.1, target: 0.95, angle: 0.25 };

const UP = new Vector3(0, 1, 0);

/** Camera with orbit controls, follow mode and automatic framing. */
export class CameraRig {
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
  /** Whether the camera is still where automatic framing put it. */
  #automatic = true;
  #reported: readonly number[] | null = null;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #followed: Vector3 | null = null;
  /** Origin of the frame: position of the framed character. */
  readonly #origin = new Vector3();
  #heading = 0;
  #inset = { top: 0, bottom: 0 };
  #size = { wide: 1, high: 1 };

  constructor(surface: HTMLElement, changed: () => void) {
    this.controls = new OrbitControls(this.camera, surface);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.25, maxDistance: 60 });
    this.controls.maxPolarAngle = 0.53 * Math.PI;
    this.controls.addEventListener("change", () => {
      if (this.#timer !== undefined) this.#scheduleReport();
      changed();
    });
    this.controls.addEventListener("start", () => {
      this.#automatic = false;
      this.#cancelReport();
    });
    this.controls.addEventListener("end", () => this.#scheduleReport());
  }

  /** Set the frame; moves the camera unless the user moved it. */
  setFrame(frame: Frame): void {
    this.#frame = frame;
    if (this.#automatic) this.#applyFrame();
  }

  /** Set camera position and target, 6 numbers. */
  set(camera: readonly number[]): void {
    if (camera.length !== 6 || !camera.every(Number.isFinite)) return;
    if (this.#reported && camera.every((value, k) => value === this.#reported?.[k])) return;
    this.#automatic = false;
    this.#reported = camera;
    const [x, y, z, tx, ty, tz] = camera as [number, number, number, number, number, number];
    this.camera.position.set(x, y, z);
    this.controls.target.set(tx, ty, tz);
    this.controls.update();
  }

  /** Frame automatically around a character at `origin`. */
  reset(origin: Vector3): void {
    this.#automatic = true;
    this.#reported = null;
    this.#followed = null;
    this.#origin.copy(origin);
    this.#cancelReport();
    this.#applyFrame();
  }

  /** Put the camera behind a character at `origin`; `turn` keeps it there. */
  chase(origin: Vector3, heading: number): void {
    this.#automatic = false;
    this.#reported = null;
    this.#heading = heading;
    this.#followed = origin.clone();
    this.#cancelReport();
    const angle = heading + BEHIND.angle;
    this.controls.target.copy(origin).setY(BEHIND.target);
    this.camera.position.copy(origin).setY(BEHIND.height);
    this.camera.position.x -= BEHIND.distance * Math.sin(angle);
    this.camera.position.z -= BEHIND.distance * Math.cos(angle);
    this.controls.update();
  }

  /** Turn around the target with the character's heading, rad; an orbit by the user remains. */
  turn(heading: number): boolean {
    const step = heading - this.#heading;
    this.#heading = heading;
    const { target } = this.controls;
    this.camera.position.sub(target).applyAxisAngle(UP, step).add(target);
    this.camera.lookAt(target);
    return Math.abs(step) > 1e-4;
  }

  resize(wide: number, high: number): void {
    this.#size = { wide, high };
    this.#project();
    if (this.#automatic) this.#applyFrame();
  }

  /** Set the covered pixels at the top and at the bottom; the frame moves away from them. */
  setInset(top: number, bottom: number): void {
    this.#inset = { top, bottom };
    this.#project();
    if (this.#automatic) this.#applyFrame();
  }

  /** Follow a position on the ground smoothly; null stops. Returns whether the camera is still moving. */
  follow(place: Vector3 | null, delta_s: number): boolean {
    if (!place) {
      this.#followed = null;
      return false;
    }
    this.#followed ??= (this.#automatic ? this.#origin : place).clone();
    const step = place.clone().sub(this.#followed);
    const far = step.length();
    if (far < 5e-4) return false;
    step.multiplyScalar(far > 3 ? 1 : 1 - Math.exp(-6 * delta_s));
    this.#followed.add(step);
    if (this.#automatic) this.#origin.copy(this.#followed);
    this.camera.position.add(step);
    this.controls.target.add(step);
    return true;
  }

  dispose(): void {
    this.#cancelReport();
    this.controls.dispose();
  }

  #project(): void {
    const { wide, high } = this.#size;
    const { top, bottom } = this.#inset;
    this.camera.aspect = wide / high;
    if (top || bottom) this.camera.setViewOffset(wide, high, 0, (bottom - top) / 2, wide, high);
    else this.camera.clearViewOffset();
    this.camera.updateProjectionMatrix();
  }

  /** Move the camera as near as the frame allows, with the frame centred. */
  #applyFrame(): void {
    const { points, from } = this.#frame;
    const { wide, high } = this.#size;
    const target = new Vector3(...box(points).centre);
    const back = new Vector3(...from).normalize();
    const right = new Vector3(0, 1, 0).cross(back).normalize();
    const up = back.clone().cross(right);
    const slope = FILLED * Math.tan((this.camera.fov * Math.PI) / 360);
    const across = (slope * wide) / high;
    const along = (slope * Math.max(high - this.#inset.top - this.#inset.bottom, 1)) / high;
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

  #cancelReport(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
  }

  /** Report the camera position after it comes to rest. */
  #scheduleReport(): void {
    this.#cancelReport();
    this.#timer = setTimeout(() => {
      this.#timer = undefined;
      const numbers = [...this.camera.position.toArray(), ...this.controls.target.toArray()];
      this.#reported = numbers.map((value) => Math.round(value * 1000) / 1000);
      this.onCamera(this.#reported);
    }, SETTLE_MS);
  }
}
