import { type Object3D, type PerspectiveCamera, Raycaster, Vector2, Vector3 } from "three";
import { type GoalHandle, pixelsPerMetre } from "./goal";
import { type ExamplePoint, type GoalSpace, intersectPlane } from "./goal_space";
import type { Marks } from "./marks";
import type { V3 } from "./vec";

/** Scene objects that the pointer acts on. */
export interface PointerContext {
  readonly camera: PerspectiveCamera;
  readonly goal: GoalHandle;
  readonly marks: Marks | null;
  readonly space: GoalSpace | null;
  /** Object whose local frame is the goal space. */
  readonly frame: Object3D;
}

/** Effects of pointer input. */
export interface PointerActions {
  /** The goal was grabbed or released; disables the camera controls meanwhile. */
  grabbed(grabbed: boolean): void;
  /** The goal was dragged to a position in goal space; `done` at the release. */
  dragged(point: V3, done: boolean): void;
  hovered(mark: { known: ExamplePoint; at: Vector3 } | null): void;
  clicked(known: ExamplePoint): void;
}

/** Largest movement of a click, pixels. */
const CLICK_PX = 4;

const numbers = (v: Vector3): V3 => [v.x, v.y, v.z];

/** Mouse, pen and touch input on the canvas: drags the goal, picks examples. */
export class Pointer {
  readonly #surface: HTMLElement;
  readonly #context: PointerContext;
  readonly #actions: PointerActions;
  readonly #stop = new AbortController();
  readonly #ray = new Raycaster();
  #drag: { id: number; aside: Vector2; y: number; at: Vector3 } | null = null;
  #press: { x: number; y: number; known: ExamplePoint } | null = null;

  constructor(surface: HTMLElement, target: PointerContext, deeds: PointerActions) {
    [this.#surface, this.#context, this.#actions] = [surface, target, deeds];
    const on = <K extends keyof HTMLElementEventMap>(name: K, then: (event: HTMLElementEventMap[K]) => void) =>
      surface.addEventListener(name, then, { signal: this.#stop.signal });
    on("pointerdown", (event) => this.#down(event));
    on("pointermove", (event) => (this.#drag ? this.#dragTo(event) : this.#hover(event)));
    on("pointerup", (event) => this.#up(event));
    on("pointercancel", (event) => this.#up(event));
    on("pointerleave", () => this.#actions.hovered(null));
  }

  get dragging(): boolean {
    return this.#drag !== null;
  }

  dispose(): void {
    this.#stop.abort();
  }

  /** World position to canvas pixels; z is −1 to 1 in front of the camera. Overwrites its argument. */
  readonly #pixels = (world: Vector3): Vector3 => {
    const { clientWidth, clientHeight } = this.#surface;
    world.project(this.#context.camera);
    return world.set((world.x * 0.5 + 0.5) * clientWidth, (0.5 - world.y * 0.5) * clientHeight, world.z);
  };

  /** Position of a world point in the window, pixels. */
  inWindow(world: Vector3): [number, number] {
    const box = this.#surface.getBoundingClientRect();
    const { x, y } = this.#pixels(world.clone());
    return [box.left + x, box.top + y];
  }

  #pixelOf(event: PointerEvent): Vector2 {
    const box = this.#surface.getBoundingClientRect();
    return new Vector2(event.clientX - box.left, event.clientY - box.top);
  }

  #down(event: PointerEvent): void {
    if (this.#drag || event.button !== 0) return;
    const at = this.#pixelOf(event);
    const { goal, marks } = this.#context;
    if (goal.hitTest(at.x, at.y, event.pointerType === "touch", this.#pixels)) {
      const centre = this.#pixels(goal.world.clone());
      const aside = new Vector2(centre.x - at.x, centre.y - at.y);
      this.#drag = { id: event.pointerId, aside, y: at.y, at: goal.world.clone() };
      this.#surface.setPointerCapture(event.pointerId);
      this.#surface.style.cursor = "grabbing";
      this.#actions.grabbed(true);
      return;
    }
    const mark = marks?.pick(at.x, at.y, this.#pixels);
    this.#press = mark ? { x: at.x, y: at.y, known: mark.known } : null;
  }

  #hover(event: PointerEvent): void {
    if (event.buttons) return;
    const at = this.#pixelOf(event);
    const { goal, marks } = this.#context;
    const near = goal.hitTest(at.x, at.y, event.pointerType === "touch", this.#pixels);
    const mark = near ? null : (marks?.pick(at.x, at.y, this.#pixels) ?? null);
    goal.setGrabbed(near ? "near" : "no");
    this.#surface.style.cursor = near ? "grab" : mark ? "pointer" : "";
    this.#actions.hovered(mark);
  }

  #dragTo(event: PointerEvent): void {
    const drag = this.#drag;
    if (!drag || event.pointerId !== drag.id) return;
    const at = this.#pixelOf(event);
    const { camera, frame, space } = this.#context;
    if (event.shiftKey && space && !space.plane) {
      const step = (drag.y - at.y) / pixelsPerMetre(camera, drag.at, this.#surface.clientHeight);
      drag.at.addScaledVector(camera.getWorldDirection(new Vector3()), step);
      const centre = this.#pixels(drag.at.clone());
      drag.aside.set(centre.x - at.x, centre.y - at.y);
    } else {
      this.#slide(drag, at);
    }
    drag.y = at.y;
    this.#actions.dragged(numbers(frame.worldToLocal(drag.at.clone())), false);
  }

  /** Move the grabbed point under the pointer, in its plane. */
  #slide(drag: { aside: Vector2; at: Vector3 }, pixel: Vector2): void {
    const { camera, frame, space } = this.#context;
    const { clientWidth, clientHeight } = this.#surface;
    const x = ((pixel.x + drag.aside.x) / clientWidth) * 2 - 1;
    const y = 1 - ((pixel.y + drag.aside.y) / clientHeight) * 2;
    this.#ray.setFromCamera(new Vector2(x, y), camera);
    const { origin, direction } = this.#ray.ray;
    const normal = space?.plane
      ? new Vector3(...space.plane.normal).transformDirection(frame.matrixWorld)
      : camera.getWorldDirection(new Vector3());
    const hit = intersectPlane(numbers(origin), numbers(direction), numbers(drag.at), numbers(normal));
    if (hit) drag.at.set(...(hit as [number, number, number]));
  }

  #up(event: PointerEvent): void {
    const drag = this.#drag;
    if (drag && event.pointerId === drag.id) {
      this.#drag = null;
      this.#surface.style.cursor = "grab";
      this.#actions.grabbed(false);
      this.#actions.dragged(numbers(this.#context.frame.worldToLocal(drag.at.clone())), true);
      return;
    }
    const press = this.#press;
    this.#press = null;
    const at = this.#pixelOf(event);
    if (press && event.type === "pointerup" && Math.hypot(at.x - press.x, at.y - press.y) <= CLICK_PX) {
      this.#actions.clicked(press.known);
    }
  }
}
