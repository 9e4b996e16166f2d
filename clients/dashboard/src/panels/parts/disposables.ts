/** Cleanup callbacks of a mounted panel. */
export class Disposables {
  disposed = false;
  private readonly callbacks: (() => void)[] = [];

  /** Register cleanup callbacks; after disposal they run at once. */
  add(...callbacks: (() => void)[]): void {
    if (this.disposed) for (const dispose of callbacks) dispose();
    else this.callbacks.push(...callbacks);
  }

  dispose(): void {
    this.disposed = true;
    for (const dispose of this.callbacks.splice(0)) dispose();
  }
}

/** Trailing throttle: calls `then` once, `afterMs` after the first of several calls. */
export function throttle(afterMs: number, then: () => void): { schedule: () => void; stop: () => void } {
  let timer: ReturnType<typeof setTimeout> | undefined;
  return {
    schedule: () => {
      timer ??= setTimeout(() => {
        timer = undefined;
        then();
      }, afterMs);
    },
    stop: () => clearTimeout(timer),
  };
}
