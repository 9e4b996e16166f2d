/** `window.adverb`: what the page shows, for tests and for the curious; read only. */

import type { Page } from "./app";
import type { Connection, Opened, Shown, Side, Stage, Stats, View } from "./types";

export interface Published {
  readonly view: View;
  readonly opened: Opened | null;
  /** What is known of the last picture of either side. */
  readonly shown: Readonly<Record<Side, Shown | null>>;
  /** Phase at which the figure is held while the goal moves, else null. */
  readonly held: number | null;
  readonly connection: Connection;
  readonly stats: Stats | null;
  /** What the stage drew last: frames so far, and world places of the effector and the goal. */
  readonly drawn: Stage["drawn"] | null;
}

declare global {
  interface Window {
    readonly adverb: Published;
  }
}

export function publish(page: Page, stage: Stage | null): void {
  const published: Published = {
    get view() {
      return page.store.view;
    },
    get opened() {
      return page.opened;
    },
    get shown() {
      return { ...page.shown };
    },
    get held() {
      return page.hold.phase;
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
  };
  Object.defineProperty(window, "adverb", { value: Object.freeze(published) });
}
