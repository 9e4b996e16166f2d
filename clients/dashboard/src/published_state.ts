/** `window.adverb`: read-only page state for tests. */

import type { Page } from "./app";
import type { OwnFigure } from "./own/own_figure";
import type { Connection, Opened, Role, Shown, Stage, Stats, View } from "./types";

export interface PublishedState {
  readonly view: View;
  readonly opened: Opened | null;
  /** Last displayed state of each figure. */
  readonly shown: Readonly<Record<Role, Shown | null>>;
  /** Phase of an automatic pause at the goal, else null. */
  readonly pausedAtGoal: number | null;
  readonly connection: Connection;
  readonly stats: Stats | null;
  /** Last drawn frame: count, world positions of effector and goal. */
  readonly drawn: Stage["drawn"] | null;
  /**
   * The user's figure: joints that move, whether the browser keeps it as it is, distances of the displayed pose, places
   * of its joints; null without one.
   */
  readonly figure: {
    readonly moved: number;
    readonly isKept: boolean;
    readonly scale: number;
    readonly effector: number | null;
    readonly feet: number | null;
    readonly places: Readonly<Record<string, readonly number[]>>;
  } | null;
}

declare global {
  interface Window {
    readonly adverb: PublishedState;
  }
}

export function publish(page: Page, stage: Stage | null, own: OwnFigure): void {
  const published: PublishedState = {
    get view() {
      return page.store.view;
    },
    get opened() {
      return page.opened;
    },
    get shown() {
      return { ...page.shown };
    },
    get pausedAtGoal() {
      return page.pauseAtGoal.phase;
    },
    get connection() {
      return page.connection;
    },
    get stats() {
      return page.stats;
    },
    get drawn() {
      return stage && { ...stage.drawn };
    },
    get figure() {
      const { model } = own;
      const { mapper } = model ?? {};
      if (!model || !mapper) return null;
      const { isKept } = own;
      return { moved: mapper.rows.length, isKept, scale: mapper.scale, ...mapper.figures, places: model.places() };
    },
  };
  Object.defineProperty(window, "adverb", { value: Object.freeze(published) });
}
