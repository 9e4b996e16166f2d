/** Verbs that interrupt the steered one: jump, punch, kick. */

import { crowdGoals } from "../crowd";
import type { Opened, Verb } from "../types";
import { adverbValues } from "../verb";

/** Names of the verbs, in the order of their buttons. */
export const ACTIONS = ["jump", "punch", "kick"] as const;
export type ActionName = (typeof ACTIONS)[number];

/** A requested action and its adverbs in the verb's order. */
export interface Action {
  readonly verb: Verb;
  readonly adverbs: readonly number[];
}

/** Share of the time after the last inner keytime, after which steering ends the action. */
const RECOVERY = 0.35;
/** Distance of a jump per speed of its run-up, s. */
const JUMP_S = 0.45;

/** Whether `switch` is possible between two verbs: equal joints and parents. */
export function sameSkeleton(a: Pick<Opened["skeleton"], "names" | "parents">, b: typeof a): boolean {
  return a.names.join("\n") === b.names.join("\n") && a.parents.join() === b.parents.join();
}

/** Phase from which steering ends an action. */
export function releasePhase({ keytime_phases: phases }: Verb): number {
  const last = phases.at(-2) ?? 0;
  return last + RECOVERY * (1 - last);
}

/**
 * Adverbs of action number `count`: a jump goes where the character moves, other verbs vary over their examples.
 *
 * @param velocity forward and to the left, m/s
 */
export function actionGoal(verb: Verb, velocity: readonly [number, number], count: number): number[] {
  const goals = crowdGoals(verb, [], count + 2);
  const goal = goals.at(-1) ?? [];
  if (verb.measure.kind !== "jump") return goal;
  const [forward, left] = [Math.max(velocity[0], 0), velocity[1]];
  const [distance, direction, height] = verb.measure.adverbs as [string, string, string];
  const range = (name: string) => verb.adverbs.find((adverb) => adverb.name === name) ?? { min: 0, max: 0 };
  const far = Math.min(JUMP_S * Math.hypot(forward, left), range(distance).max);
  const angle = far > 0 ? Math.atan2(left, forward) : 0;
  const high = (range(height).min + range(height).max) / 2;
  return adverbValues(verb, { [distance]: far, [direction]: angle, [height]: high });
}

/** The current action and the next one. */
export class Actions {
  current: Action | null = null;
  private next: (() => Action) | null = null;
  /** Whether the current action was displayed before its recovery. */
  private begun = false;

  /** Start an action, or start it after the current one. */
  request(make: () => Action): void {
    if (this.current) this.next = make;
    else this.current = make();
  }

  /** The current action is at its end. */
  end(): void {
    this.current = this.next?.() ?? null;
    this.next = null;
    this.begun = false;
  }

  /** Follow the displayed phase; the action ends early if the character is steered and it has recovered. */
  shown(verb: string, phase: number, steered: boolean): void {
    if (this.current?.verb.name !== verb) return;
    const recovered = phase >= releasePhase(this.current.verb);
    if (!recovered) this.begun = true;
    else if (steered && this.begun) this.end();
  }

  clear(): void {
    this.current = this.next = null;
    this.begun = false;
  }
}
