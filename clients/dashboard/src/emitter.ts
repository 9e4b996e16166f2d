/** Who wants to know, and what there is to tell; typed by event. */
export class Emitter<Events> {
  private readonly listeners = new Map<keyof Events, Set<(what: never) => void>>();

  on<Name extends keyof Events>(event: Name, then: (what: Events[Name]) => void): () => void {
    const known = this.listeners.get(event) ?? new Set();
    this.listeners.set(event, known.add(then));
    return () => void known.delete(then);
  }

  emit<Name extends keyof Events>(event: Name, what: Events[Name]): void {
    for (const then of [...(this.listeners.get(event) ?? [])]) (then as (what: Events[Name]) => void)(what);
  }
}
