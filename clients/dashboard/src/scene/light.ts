import { DirectionalLight, Group, HemisphereLight } from "three";
import type { Palette } from "./palette";
import type { V3 } from "./vec";

/** Sky light, shadow-casting key light and rim light. */
export class Lights {
  readonly group = new Group();
  readonly #sky = new HemisphereLight();
  readonly #key = new DirectionalLight("#fff3e2", 2.4);
  readonly #rim = new DirectionalLight("#dfeaff", 0.9);

  constructor() {
    const { shadow } = this.#key;
    this.#key.castShadow = true;
    shadow.mapSize.set(2048, 2048);
    shadow.radius = 3;
    shadow.bias = -0.0002;
    this.#rim.position.set(1.2, 1.1, -1.6);
    this.group.add(this.#sky, this.#key, this.#key.target, this.#rim, this.#rim.target);
  }

  /** Light a sphere around a position from a direction. */
  aim(x: number, y: number, z: number, radius: number, from: V3): void {
    const far = 3 * radius;
    const { camera } = this.#key.shadow;
    this.#key.target.position.set(x, y, z);
    this.#key.position.set(x + far * from[0], y + far * from[1], z + far * from[2]);
    if (camera.right !== radius) {
      Object.assign(camera, { left: -radius, right: radius, top: radius, bottom: -radius, near: 0.1, far: 9 * radius });
      this.#key.shadow.normalBias = 0.004 * Math.min(radius, 3);
      camera.updateProjectionMatrix();
    }
  }

  setShadows(on: boolean): void {
    this.#key.castShadow = on;
  }

  setPalette(palette: Palette): void {
    this.#sky.color.copy(palette.sky);
    this.#sky.groundColor.copy(palette.earth);
    this.#sky.intensity = palette.dark ? 1.1 : 1.7;
    this.#key.intensity = palette.dark ? 2.3 : 2.5;
    this.#rim.intensity = palette.dark ? 1.6 : 0.7;
  }

  dispose(): void {
    this.#key.dispose();
  }
}
