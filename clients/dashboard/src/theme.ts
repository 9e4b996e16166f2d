/** Light or dark theme, from the view or the system. */

import type { Store } from "./types";

export class ThemeController {
  private readonly system = matchMedia("(prefers-color-scheme: dark)");
  private readonly listeners = new Set<(dark: boolean) => void>();

  constructor(
    private readonly store: Store,
    private readonly root: HTMLElement,
  ) {
    store.on(["theme"], () => this.show());
    this.system.addEventListener("change", () => this.show());
    this.show();
  }

  get dark(): boolean {
    const { theme } = this.store.view;
    return theme === "auto" ? this.system.matches : theme === "dark";
  }

  /** Call `then` now and on every change; returns the unsubscribe function. */
  on(then: (dark: boolean) => void): () => void {
    this.listeners.add(then);
    then(this.dark);
    return () => void this.listeners.delete(then);
  }

  private show(): void {
    this.root.dataset.theme = this.dark ? "dark" : "light";
    for (const then of this.listeners) then(this.dark);
  }
}
