/** Drive mode: input devices steer a verb with measured velocities; keys start other verbs in between. */

import type { Motion } from "adverb-client";
import type { Page } from "../app";
import type { Verb } from "../types";
import { ACTIONS, type Action, type ActionName, Actions, actionGoal, sameSkeleton } from "./actions";
import { browserPads, GamepadInput, Keyboard } from "./devices";
import { type Axes, axesOf, STILL, type Steering, steer, sum } from "./steering";

export const DRIVEN_VERB = "locomotion";

/** Time in which half of the way to a new velocity is covered, s: a person does not start at once. */
const HALF_LIFE_S = 0.2;
const DIGITS = 3;

type Host = Pick<Page, "store" | "rest" | "verb" | "verbs" | "shown" | "on">;

export class Drive {
  /** Steering of the stick on the screen. */
  touch: Steering = STILL;
  readonly gamepad = new GamepadInput(browserPads, (name) => this.act(name));
  readonly keyboard = new Keyboard(
    () => this.active,
    (name) => this.act(name),
  );
  /** Called when the available actions changed. */
  onActions: () => void = () => {};
  private axes: Axes | null = null;
  private verbs = new Map<ActionName, Verb>();
  private readonly actions = new Actions();
  private count = 0;
  private steered = "";

  constructor(private readonly page: Host) {
    page.on("verb", (verb) => void this.prepare(verb));
    page.on("verbs", () => page.verb && void this.prepare(page.verb));
    page.store.on(["drive", "verb", "draft"], () => {
      this.steered = "";
      this.actions.clear();
    });
  }

  get active(): boolean {
    const { verb, store } = this.page;
    return store.view.drive && !store.view.draft && this.axes !== null && verb?.name === store.view.verb;
  }

  /** Verb that interrupts the steered one. */
  get action(): Action | null {
    return this.active ? this.actions.current : null;
  }

  /** Whether an action is served and has the skeleton of the steered verb. */
  has(name: ActionName): boolean {
    return this.verbs.has(name);
  }

  act(name: ActionName): void {
    const verb = this.verbs.get(name);
    if (!verb || !this.active) return;
    this.actions.request(() => ({ verb, adverbs: actionGoal(verb, this.velocity(), this.count++) }));
  }

  /** The motion of the steered character ended, or the server refused it. */
  end(): void {
    this.actions.end();
  }

  /** Whether a displayed verb belongs to the steered character. */
  shows(verb: string): boolean {
    return this.active && [...this.verbs.values()].some(({ name }) => name === verb);
  }

  /** Motion of the steered character. */
  motion(main: Motion): Motion {
    const driven = { ...main, playing: true, loop: true, speed: 1, halfLife: HALF_LIFE_S, switches: true };
    const { action } = this;
    if (!action) return driven;
    const { name, adverbs } = action.verb;
    return { ...driven, verb: name, method: "", names: adverbs.map((adverb) => adverb.name), loop: false };
  }

  /** Read the devices and set the goal; call once per animation frame. */
  frame(): void {
    const { store, shown } = this.page;
    if (!this.active || !this.axes) return;
    const steering = sum([this.keyboard.steering, this.gamepad.poll(), this.touch]);
    const key = JSON.stringify(steering);
    if (shown.main) this.actions.shown(shown.main.verb, shown.main.phase, key !== JSON.stringify(STILL));
    if (key === this.steered) return;
    this.steered = key;
    const goal = Object.entries(steer(this.axes, steering)).map(([name, value]) => [
      name,
      Number(value.toFixed(DIGITS)),
    ]);
    store.change({ goal: { ...store.view.goal, ...Object.fromEntries(goal) } });
  }

  /** Requested velocity forward and to the left, m/s. */
  velocity(): [number, number] {
    const { goal } = this.page.store.view;
    const [forward, side] = this.axes ? [this.axes.forward, this.axes.side] : [];
    return [(goal[forward?.name ?? ""] ?? 0) * (forward?.si ?? 1), (goal[side?.name ?? ""] ?? 0) * (side?.si ?? 1)];
  }

  /** Requested turn rate, rad/s; positive turns left. */
  turnRate(): number {
    const { goal } = this.page.store.view;
    return (goal[this.axes?.turn.name ?? ""] ?? 0) * (this.axes?.turn.si ?? 1);
  }

  /** Load the actions that a verb can switch to. */
  private async prepare(verb: Verb): Promise<void> {
    this.axes = axesOf(verb);
    const served = ACTIONS.filter((name) => this.page.verbs.some((each) => each.name === name));
    const all = this.axes ? await Promise.all(served.map((name) => this.page.rest.verb(name).catch(() => null))) : [];
    if (this.page.verb !== verb) return;
    const usable = all.flatMap((each, k) =>
      each && sameSkeleton(each.skeleton, verb.skeleton) ? [[served[k] as ActionName, each] as const] : [],
    );
    this.verbs = new Map(usable);
    this.onActions();
  }
}
