import {
  BufferGeometry,
  DoubleSide,
  Float32BufferAttribute,
  Group,
  Mesh,
  MeshBasicMaterial,
  PlaneGeometry,
  Quaternion,
  ShaderMaterial,
  ShadowMaterial,
  Vector2,
  Vector3,
} from "three";
import type { Palette } from "./palette";
import type { Slope, SlopedGround } from "./slope";

const VERTEX = `
uniform float reach;
varying vec2 place;
void main() {
  place = position.xy * 2.0 * reach;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

/** Grid lines every 0.1 m and 1 m, one pixel wide; fine lines fade out with distance. */
const FRAGMENT = `
uniform vec3 tint;
uniform float strength;
uniform float reach;
uniform vec2 middle;
varying vec2 place;
float lines(vec2 at, float step) {
  vec2 cell = at / step;
  vec2 width = fwidth(cell);
  vec2 near = abs(fract(cell - 0.5) - 0.5) / max(width, vec2(1e-5));
  vec2 line = 1.0 - min(near, vec2(1.0));
  line *= 1.0 - smoothstep(vec2(0.15), vec2(0.45), width);
  return max(line.x, line.y);
}
void main() {
  vec2 at = place + middle;
  float away = length(place) / reach;
  float fade = 1.0 - smoothstep(0.25, 1.0, away);
  float near = 1.0 - smoothstep(0.1, 0.5, away);
  float line = max(0.75 * lines(at, 1.0), 0.26 * near * lines(at, 0.1));
  gl_FragColor = vec4(tint, strength * fade * line);
  #include <colorspace_fragment>
}`;

/** Two triangles along x. */
function stroke(from: number, to: number, half: number): number[] {
  return [from, -half, 0, to, -half, 0, to, half, 0, from, -half, 0, to, half, 0, from, half, 0];
}

/** Depth of the ground below y = 0: captured feet penetrate it by a few millimetres. */
const SUNK_M = 0.004;

const LEVEL: Slope = { x: 0, y: 0, z: 0, course: 0, gradient: 0 };
const FLAT = new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), -Math.PI / 2);

/** Reference plane with grid: the ground, or the wall behind a planar arm. */
export class Ground {
  readonly group = new Group();
  readonly #uniforms = {
    tint: { value: { r: 0, g: 0, b: 0 } },
    strength: { value: 0.5 },
    reach: { value: 6 },
    middle: { value: new Vector2() },
  };
  readonly #grid: Mesh<PlaneGeometry, ShaderMaterial>;
  readonly #shade: Mesh<PlaneGeometry, ShadowMaterial>;
  readonly #bar: Mesh<BufferGeometry, MeshBasicMaterial>;
  #wall = false;
  #slope: Slope | null = null;

  constructor() {
    const plane = new PlaneGeometry(1, 1);
    this.#grid = new Mesh(
      plane,
      new ShaderMaterial({
        uniforms: this.#uniforms,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        transparent: true,
        depthWrite: false,
        side: DoubleSide,
      }),
    );
    this.#shade = new Mesh(plane, new ShadowMaterial({ transparent: true, depthWrite: false }));
    this.#shade.receiveShadow = true;
    const bar = new BufferGeometry();
    const strokes = [...stroke(0, 1, 0.004), ...stroke(0, 0.008, 0.025), ...stroke(0.992, 1, 0.025)];
    bar.setAttribute("position", new Float32BufferAttribute(strokes, 3));
    this.#bar = new Mesh(bar, new MeshBasicMaterial());
    this.#grid.renderOrder = -2;
    this.#shade.renderOrder = -1;
    this.group.add(this.#grid, this.#shade, this.#bar);
  }

  /** Ground at y = 0, or wall at z = `back`; the grid extends `size` metres. */
  lay(wall: boolean, back: number, size: number): void {
    this.#wall = wall;
    this.#slope = null;
    this.group.rotation.set(0, 0, 0);
    this.group.rotation.x = wall ? 0 : -Math.PI / 2;
    this.group.position.set(0, wall ? 0 : -SUNK_M, wall ? back : 0);
    this.#uniforms.reach.value = size;
    this.#grid.scale.set(2 * size, 2 * size, 1);
    this.#shade.scale.set(4 * size, 4 * size, 1);
  }

  /** Tilt the ground to the slope under a character. */
  tilt({ slope, tilt }: SlopedGround): void {
    if (this.#wall || (!slope && !this.#slope)) return;
    this.#slope = slope;
    const { x, y, z } = slope ?? LEVEL;
    this.group.quaternion.copy(tilt).multiply(FLAT);
    this.group.position.set(x, y - SUNK_M, z);
  }

  /** Centre the grid on the camera target with its lines fixed in the world. */
  centre(x: number, y: number, z: number): void {
    const { x: ox, z: oz } = this.#slope ?? LEVEL;
    const [u, v] = this.#wall ? [x, y] : this.#onPlane(x - ox, z - oz);
    const [originU, originV] = this.#wall ? [0, 0] : this.#onPlane(ox, oz);
    this.#grid.position.set(u, v, 0);
    this.#shade.position.set(u, v, 0);
    this.#uniforms.middle.value.set(u + originU, v + originV);
  }

  /** Position of the 1 m bar's left end on the plane: x and z on the ground, x and y on the wall. */
  putBar(u: number, v: number): void {
    const { x, z } = this.#slope ?? LEVEL;
    const [right, up] = this.#wall ? [u, v] : this.#onPlane(u - x, v - z);
    this.#bar.position.set(right, up, 0.002);
    this.#bar.scale.y = this.#wall ? 1 : 2; // compensates the low viewing angle
  }

  /** Coordinates on the plane of a horizontal offset: a slope is longer than its projection. */
  #onPlane(x: number, z: number): [number, number] {
    const { course, gradient } = this.#slope ?? LEVEL;
    const longer = (Math.hypot(1, gradient) - 1) * (x * Math.sin(course) + z * Math.cos(course));
    return [x + longer * Math.sin(course), -z - longer * Math.cos(course)];
  }

  get bar(): Mesh {
    return this.#bar;
  }

  setPalette(palette: Palette): void {
    this.#uniforms.tint.value = palette.line;
    this.#uniforms.strength.value = palette.dark ? 0.62 : 0.55;
    this.#shade.material.opacity = palette.shadow;
    this.#bar.material.color.copy(palette.line);
  }

  dispose(): void {
    this.#grid.geometry.dispose();
    this.#grid.material.dispose();
    this.#shade.material.dispose();
    this.#bar.geometry.dispose();
    this.#bar.material.dispose();
  }
}
