/** Typed event emitter. */
export class Emitter<Events> {
  private readonly listeners = new Map<keyof Events, Set<(event: never) => void>>();

  on<Name extends keyof Events>(event: Name, then: (event: Events[Name]) => void): () => void {
    const known = this.listeners.get(event) ?? new Set();
    this.listeners.set(event, known.add(then));
    return () => void known.delete(then);
  }

  /** Call all listeners; an error of one is thrown outside, as if it were alone. */
  emit<Name extends keyof Events>(name: Name, event: Events[Name]): void {
    for (const then of [...(this.listeners.get(name) ?? [])]) {
      try {
        (then as (event: Events[Name]) => void)(event);
      } catch (err) {
        queueMicrotask(() => {
          throw err;
        });
      }
    }
  }
}
