/** Asks for one thing at a time: what is asked for meanwhile waits, and only the newest of it is asked. */
export class Latest<Value> {
  private running: { path: string; stop: AbortController } | null = null;
  private waiting: string | null = null;
  private told = "";

  constructor(
    private readonly ask: (path: string, signal: AbortSignal) => Promise<Value>,
    private readonly then: (answer: { value: Value } | { problem: unknown }) => void,
  ) {}

  /** Whether an answer is under way. */
  get late(): boolean {
    return this.running !== null;
  }

  /** Want an answer; one that is under way is dropped where it is of no use any more, and else waited for. */
  want(path: string, useless: boolean): void {
    if (useless) this.stop();
    if (this.running) this.waiting = path === this.running.path ? null : path;
    else if (path !== this.told) void this.start(path);
  }

  stop(): void {
    this.running?.stop.abort();
    this.running = this.waiting = null;
    this.told = "";
  }

  private async start(path: string): Promise<void> {
    const run = { path, stop: new AbortController() };
    this.running = run;
    let answer: { value: Value } | { problem: unknown };
    try {
      answer = { value: await this.ask(path, run.stop.signal) };
    } catch (problem) {
      answer = { problem };
    }
    if (this.running !== run) return;
    const next = this.waiting;
    this.running = this.waiting = null;
    this.told = "value" in answer ? path : "";
    if (next !== null) void this.start(next);
    this.then(answer);
  }
}
