/** Runs asynchronous tasks one after the other, in order. */
export class SerialQueue {
  private readonly tasks: (() => Promise<void>)[] = [];
  private running = false;

  /** Add a task; returns whether it waits for another one. */
  add(task: () => Promise<void>): boolean {
    this.tasks.push(task);
    if (this.running) return true;
    void this.run();
    return false;
  }

  /** Remove a waiting task. */
  remove(task: () => Promise<void>): void {
    const at = this.tasks.indexOf(task);
    if (at >= 0) this.tasks.splice(at, 1);
  }

  private async run(): Promise<void> {
    this.running = true;
    for (let next = this.tasks.shift(); next; next = this.tasks.shift()) await next().catch(() => {});
    this.running = false;
  }
}
