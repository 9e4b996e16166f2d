import {
  BackSide,
  BufferGeometry,
  DoubleSide,
  Float32BufferAttribute,
  Group,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  SphereGeometry,
  Vector3,
} from "three";
import type { Verb } from "../types";
import { type ExamplePoint, examplePoints, type GoalSpace, pseudoExamplePoints } from "./goal_space";
import { hullOf } from "./hull";
import type { Palette } from "./palette";
import type { V3 } from "./vec";

/** Pick radius of a mark, pixels. */
const NEAR_PX = 11;

/** Hull, examples and pseudo-examples of one verb, in its goal space. */
export class Marks {
  readonly group = new Group();
  /** Positions of all marks, for framing. */
  readonly points: readonly V3[];
  readonly #known: readonly { readonly known: ExamplePoint; readonly at: Vector3; readonly of: InstancedMesh }[];
  readonly #hull = new Group();
  readonly #examples: InstancedMesh<SphereGeometry, MeshBasicMaterial>;
  readonly #pseudo: InstancedMesh<SphereGeometry, MeshBasicMaterial>;
  readonly #face = new MeshBasicMaterial({ transparent: true, opacity: 0.07, depthWrite: false, side: BackSide });
  readonly #edge = new LineBasicMaterial({ transparent: true, opacity: 0.45, depthWrite: false });

  constructor(verb: Verb, space: GoalSpace | null) {
    const [examples, pseudo] = space ? [examplePoints(verb), pseudoExamplePoints(verb)] : [[], []];
    this.#examples = this.#dots(examples.length, space?.movesWithCharacter ? 0.018 : 0.0095);
    this.#pseudo = this.#dots(pseudo.length, space?.movesWithCharacter ? 0.011 : 0.006);
    const known = [
      ...examples.map((one) => [one, this.#examples] as const),
      ...pseudo.map((one) => [one, this.#pseudo] as const),
    ];
    this.#known = known.map(([one, of]) => {
      return { known: one, of, at: new Vector3(...(space?.point(one.adverbs) ?? [0, 0, 0])) };
    });
    this.points = this.#known.map(({ at }) => [at.x, at.y, at.z]);
    this.#put(space?.plane?.normal[1] === 1 ? 0.006 : 0);
    if (space) this.#wrap(verb, space, examples);
    this.group.add(this.#hull, this.#examples, this.#pseudo);
  }

  show(marks: { hull: boolean; examples: boolean; pseudo: boolean }): void {
    this.#hull.visible = marks.hull;
    this.#examples.visible = marks.examples;
    this.#pseudo.visible = marks.pseudo;
  }

  setPalette(palette: Palette): void {
    this.#face.color.copy(palette.accent);
    this.#face.opacity = palette.dark ? 0.09 : 0.075;
    this.#edge.color.copy(palette.accent);
    this.#examples.material.color.copy(palette.example);
    this.#pseudo.material.color.copy(palette.pseudo);
  }

  /** Nearest visible mark within the pick radius; `to` projects world positions to pixels. */
  pick(x: number, y: number, to: (world: Vector3) => Vector3): { known: ExamplePoint; at: Vector3 } | null {
    let best: { known: ExamplePoint; at: Vector3 } | null = null;
    let least = NEAR_PX;
    for (const { known, at, of } of this.#known) {
      if (!of.visible) continue;
      const world = this.group.localToWorld(at.clone());
      const pixel = to(world.clone());
      const away = Math.hypot(pixel.x - x, pixel.y - y);
      if (pixel.z < 1 && away < least) [best, least] = [{ known, at: world }, away];
    }
    return best;
  }

  dispose(): void {
    for (const child of this.#hull.children) (child as Mesh).geometry.dispose();
    for (const dots of [this.#examples, this.#pseudo]) {
      dots.geometry.dispose();
      dots.material.dispose();
      dots.dispose();
    }
    this.#face.dispose();
    this.#edge.dispose();
  }

  #dots(count: number, radius: number): InstancedMesh<SphereGeometry, MeshBasicMaterial> {
    const dots = new InstancedMesh(new SphereGeometry(radius, 14, 10), new MeshBasicMaterial(), Math.max(count, 1));
    dots.count = count;
    dots.frustumCulled = false;
    return dots;
  }

  #put(lift: number): void {
    const space = new Matrix4();
    const filled = new Map<InstancedMesh, number>();
    for (const { at, of } of this.#known) {
      const k = filled.get(of) ?? 0;
      of.setMatrixAt(k, space.setPosition(at.x, at.y + lift, at.z));
      filled.set(of, k + 1);
    }
  }

  #wrap(verb: Verb, space: GoalSpace, examples: readonly ExamplePoint[]): void {
    const hull = hullOf(verb, space, examples);
    if (!hull) return;
    const geometry = (points: Float32Array) =>
      new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points, 3));
    if (space.plane) this.#face.side = DoubleSide;
    const face = new Mesh(geometry(hull.faces), this.#face);
    const edge = new LineSegments(geometry(hull.edges), this.#edge);
    [face.renderOrder, edge.renderOrder] = [4, 5];
    if (space.plane?.normal[1] === 1) this.#hull.position.y = 0.004;
    this.#hull.add(face, edge);
  }
}
