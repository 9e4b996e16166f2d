import { type Object3D, type PerspectiveCamera, Raycaster, Vector2, Vector3 } from "three";
import { type GoalHandle, pixelsPerMetre } from "./goal";
import { type Known, meet, type Place } from "./goal_space";
import type { Marks } from "./marks";
import type { V3 } from "./vec";

/** What the pointer can meet, as it is at the moment. */
export interface Target {
  readonly camera: PerspectiveCamera;
  readonly goal: GoalHandle;
  readonly marks: Marks | null;
  readonly place: Place | null;
  /** The object in whose space the verb's places are. */
  readonly frame: Object3D;
}

/** What the pointer does. */
export interface Deeds {
  /** Take hold of the goal, so that the camera stays where it is. */
  held(held: boolean): void;
  /** The goal was moved to a place of the verb's space; `done` when it was let go. */
  moved(point: V3, done: boolean): void;
  hovered(mark: { known: Known; at: Vector3 } | null): void;
  chosen(known: Known): void;
}

/** How far a click may wander, pixels. */
const CLICK_PX = 4;

const numbers = (v: Vector3): V3 => [v.x, v.y, v.z];

/** Mouse, pen and finger on the picture: drags the goal, points at examples. */
export class Pointer {
  readonly #surface: HTMLElement;
  readonly #target: Target;
  readonly #deeds: Deeds;
  readonly #stop = new AbortController();
  readonly #ray = new Raycaster();
  #drag: { id: number; aside: Vector2; y: number; at: Vector3 } | null = null;
  #press: { x: number; y: number; known: Known } | null = null;

  constructor(surface: HTMLElement, target: Target, deeds: Deeds) {
    [this.#surface, this.#target, this.#deeds] = [surface, target, deeds];
    const on = <K extends keyof HTMLElementEventMap>(name: K, then: (event: HTMLElementEventMap[K]) => void) =>
      surface.addEventListener(name, then, { signal: this.#stop.signal });
    on("pointerdown", (event) => this.#down(event));
    on("pointermove", (event) => (this.#drag ? this.#pull(event) : this.#hover(event)));
    on("pointerup", (event) => this.#up(event));
    on("pointercancel", (event) => this.#up(event));
    on("pointerleave", () => this.#deeds.hovered(null));
  }

  get dragging(): boolean {
    return this.#drag !== null;
  }

  dispose(): void {
    this.#stop.abort();
  }

  /** World place to pixels of the surface; z stays -1 to 1 in front of the camera. Overwrites its argument. */
  readonly #pixels = (world: Vector3): Vector3 => {
    const { clientWidth, clientHeight } = this.#surface;
    world.project(this.#target.camera);
    return world.set((world.x * 0.5 + 0.5) * clientWidth, (0.5 - world.y * 0.5) * clientHeight, world.z);
  };

  /** Where a world place is in the window, pixels. */
  inWindow(world: Vector3): [number, number] {
    const box = this.#surface.getBoundingClientRect();
    const { x, y } = this.#pixels(world.clone());
    return [box.left + x, box.top + y];
  }

  #at(event: PointerEvent): Vector2 {
    const box = this.#surface.getBoundingClientRect();
    return new Vector2(event.clientX - box.left, event.clientY - box.top);
  }

  #down(event: PointerEvent): void {
    if (this.#drag || event.button !== 0) return;
    const at = this.#at(event);
    const { goal, marks } = this.#target;
    if (goal.holds(at.x, at.y, event.pointerType === "touch", this.#pixels)) {
      const centre = this.#pixels(goal.world.clone());
      const aside = new Vector2(centre.x - at.x, centre.y - at.y);
      this.#drag = { id: event.pointerId, aside, y: at.y, at: goal.world.clone() };
      this.#surface.setPointerCapture(event.pointerId);
      this.#surface.style.cursor = "grabbing";
      this.#deeds.held(true);
      return;
    }
    const mark = marks?.pick(at.x, at.y, this.#pixels);
    this.#press = mark ? { x: at.x, y: at.y, known: mark.known } : null;
  }

  #hover(event: PointerEvent): void {
    if (event.buttons) return;
    const at = this.#at(event);
    const { goal, marks } = this.#target;
    const near = goal.holds(at.x, at.y, event.pointerType === "touch", this.#pixels);
    const mark = near ? null : (marks?.pick(at.x, at.y, this.#pixels) ?? null);
    goal.setHeld(near ? "near" : "no");
    this.#surface.style.cursor = near ? "grab" : mark ? "pointer" : "";
    this.#deeds.hovered(mark);
  }

  #pull(event: PointerEvent): void {
    const drag = this.#drag;
    if (!drag || event.pointerId !== drag.id) return;
    const at = this.#at(event);
    const { camera, frame, place } = this.#target;
    if (event.shiftKey && place && !place.plane) {
      const step = (drag.y - at.y) / pixelsPerMetre(camera, drag.at, this.#surface.clientHeight);
      drag.at.addScaledVector(camera.getWorldDirection(new Vector3()), step);
      const centre = this.#pixels(drag.at.clone());
      drag.aside.set(centre.x - at.x, centre.y - at.y);
    } else {
      this.#slide(drag, at);
    }
    drag.y = at.y;
    this.#deeds.moved(numbers(frame.worldToLocal(drag.at.clone())), false);
  }

  /** Move what is held to under the pointer, in its plane. */
  #slide(drag: { aside: Vector2; at: Vector3 }, pixel: Vector2): void {
    const { camera, frame, place } = this.#target;
    const { clientWidth, clientHeight } = this.#surface;
    const x = ((pixel.x + drag.aside.x) / clientWidth) * 2 - 1;
    const y = 1 - ((pixel.y + drag.aside.y) / clientHeight) * 2;
    this.#ray.setFromCamera(new Vector2(x, y), camera);
    const { origin, direction } = this.#ray.ray;
    const normal = place?.plane
      ? new Vector3(...place.plane.normal).transformDirection(frame.matrixWorld)
      : camera.getWorldDirection(new Vector3());
    const hit = meet(numbers(origin), numbers(direction), numbers(drag.at), numbers(normal));
    if (hit) drag.at.set(...(hit as [number, number, number]));
  }

  #up(event: PointerEvent): void {
    const drag = this.#drag;
    if (drag && event.pointerId === drag.id) {
      this.#drag = null;
      this.#surface.style.cursor = "grab";
      this.#deeds.held(false);
      this.#deeds.moved(numbers(this.#target.frame.worldToLocal(drag.at.clone())), true);
      return;
    }
    const press = this.#press;
    this.#press = null;
    const at = this.#at(event);
    if (press && event.type === "pointerup" && Math.hypot(at.x - press.x, at.y - press.y) <= CLICK_PX) {
      this.#deeds.chosen(press.known);
    }
  }
}
