/** Runs one request at a time; of the requests made meanwhile only the newest is sent. */
export class LatestRequest<Value> {
  private running: { path: string; stop: AbortController } | null = null;
  private waiting: string | null = null;
  private answered = "";

  constructor(
    private readonly send: (path: string, signal: AbortSignal) => Promise<Value>,
    private readonly onResult: (answer: { value: Value } | { problem: unknown }) => void,
  ) {}

  /** Whether a request is running. */
  get pending(): boolean {
    return this.running !== null;
  }

  /** Request a path. `useless` aborts the running request; otherwise it finishes first. */
  request(path: string, useless: boolean): void {
    if (useless) this.stop();
    if (this.running) this.waiting = path === this.running.path ? null : path;
    else if (path !== this.answered) void this.start(path);
  }

  stop(): void {
    this.running?.stop.abort();
    this.running = this.waiting = null;
    this.answered = "";
  }

  private async start(path: string): Promise<void> {
    const run = { path, stop: new AbortController() };
    this.running = run;
    let answer: { value: Value } | { problem: unknown };
    try {
      answer = { value: await this.send(path, run.stop.signal) };
    } catch (problem) {
      answer = { problem };
    }
    if (this.running !== run) return;
    const next = this.waiting;
    this.running = this.waiting = null;
    this.answered = "value" in answer ? path : "";
    if (next !== null) void this.start(next);
    this.onResult(answer);
  }
}
