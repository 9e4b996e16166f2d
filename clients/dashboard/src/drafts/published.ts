/** `window.adverbDraft`: read-only state of the open draft for tests. */

import type { DraftScene } from "./draft_scene";
import type { Draft } from "./types";

export interface DraftState {
  readonly draft: Draft;
  readonly saving: boolean;
  readonly phase: number;
  readonly goal: Readonly<Record<string, number>> | null;
  /** Revision of the displayed blend. */
  readonly blend: number;
  readonly drawn: DraftScene["stage"]["drawn"];
}

declare global {
  interface Window {
    readonly adverbDraft?: DraftState | null;
  }
}

/** Publish until the returned function is called. */
export function publishDraftState(of: () => { draft: Draft; saving: boolean; scene: DraftScene }): () => void {
  const get = (): DraftState => {
    const { draft, saving, scene } = of();
    const { phase } = scene.player;
    return { draft, saving, phase, goal: scene.goal, blend: scene.blendRevision, drawn: { ...scene.stage.drawn } };
  };
  Object.defineProperty(window, "adverbDraft", { get, configurable: true });
  return () => Object.defineProperty(window, "adverbDraft", { value: null, configurable: true });
}
