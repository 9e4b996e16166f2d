import { CircleGeometry, Color, DynamicDrawUsage, InstancedMesh, Matrix4, MeshBasicMaterial, Vector3 } from "three";
import type { Anatomy } from "./anatomy";
import type { Palette } from "./palette";
import { footPoints, SlideMeter } from "./slide_meter";
import type { SlopedGround } from "./slope";

const ONE = new Vector3(1, 1, 1);

/** Radius of a disc, and its height above the ground, m. */
const RADIUS_M = 0.08;
const LIFT_M = 0.002;
/** A slide of this length has the warning colour, m. */
const FAR_M = 0.01;

/** Discs under the standing feet of one character. */
export class Feet {
  readonly mesh: InstancedMesh<CircleGeometry, MeshBasicMaterial>;
  readonly #meter: SlideMeter;
  readonly #standing = new Color();
  readonly #sliding = new Color();

  constructor(anatomy: Anatomy) {
    this.#meter = new SlideMeter(footPoints(anatomy));
    const flat = new CircleGeometry(RADIUS_M, 24).rotateX(-Math.PI / 2);
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.4, depthWrite: false });
    this.mesh = new InstancedMesh(flat, material, Math.max(this.#meter.points.length, 1));
    this.mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    this.mesh.frustumCulled = false;
    this.mesh.count = 0;
  }

  /** Number of standing points of the feet. */
  get contacts(): number {
    return this.mesh.count;
  }

  /** Largest slide of the current stances, m; null if no foot stands. */
  get slide(): number | null {
    return this.#meter.slide;
  }

  update(positions: Float32Array, now_s: number, ground: SlopedGround): void {
    this.#meter.update(positions, now_s, ground.slope);
    const [at, place] = [new Matrix4(), new Vector3()];
    let count = 0;
    for (const [k, stance] of this.#meter.stances.entries()) {
      const joint = this.#meter.points[k]?.joint ?? 0;
      if (!stance) continue;
      const [x, z] = [positions[3 * joint] as number, positions[3 * joint + 2] as number];
      at.compose(place.set(x, ground.height(x, z) + LIFT_M, z), ground.tilt, ONE);
      this.mesh.setMatrixAt(count, at);
      this.mesh.setColorAt(count++, stance.slide < FAR_M ? this.#standing : this.#sliding);
    }
    this.mesh.count = count;
    this.mesh.instanceMatrix.needsUpdate = true;
    if (this.mesh.instanceColor) this.mesh.instanceColor.needsUpdate = true;
  }

  setPalette(palette: Palette): void {
    this.#standing.copy(palette.accent);
    this.#sliding.copy(palette.pseudo);
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.mesh.dispose();
  }
}
