/** What a panel has started, and how all of it ends. */
export class Life {
  over = false;
  private readonly ends: (() => void)[] = [];

  /** Remember how something is stopped; where the panel is gone already, it is stopped at once. */
  add(...ends: (() => void)[]): void {
    if (this.over) for (const end of ends) end();
    else this.ends.push(...ends);
  }

  end(): void {
    this.over = true;
    for (const end of this.ends.splice(0)) end();
  }
}

/** Calls `then` once, a while after the first of several calls. */
export function soon(afterMs: number, then: () => void): { ask: () => void; stop: () => void } {
  let timer: ReturnType<typeof setTimeout> | undefined;
  return {
    ask: () => {
      timer ??= setTimeout(() => {
        timer = undefined;
        then();
      }, afterMs);
    },
    stop: () => clearTimeout(timer),
  };
}
