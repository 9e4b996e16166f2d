/** Verbs by name and version, downloaded when they are needed first. */

import { AdverbError } from "../errors.js";
import type { Client } from "../rest/client.js";
import { Evaluator } from "./evaluator.js";

/** Interval between two attempts, ms. */
const AGAIN_MS = 2_000;
/** Versions that are kept. */
const MOST = 16;

interface Entry {
  evaluator: Evaluator | null;
  failed: AdverbError | null;
  againMs: number;
}

export class Evaluators {
  private readonly entries = new Map<string, Entry>();

  /** @param onLoaded called after each download */
  constructor(
    private readonly client: Pick<Client, "verbFile">,
    private readonly onLoaded: () => void = () => {},
  ) {}

  /** A version, or null while it is downloaded; call again. */
  of(verb: string, version: number): Evaluator | null {
    const key = `${verb}\n${version}`;
    const entry = this.entries.get(key);
    if (!entry || (entry.failed && performance.now() > entry.againMs)) this.load(key, verb, version);
    return entry?.evaluator ?? null;
  }

  /** Why a version could not be downloaded, until another attempt succeeds; else null. */
  failure(verb: string, version: number): AdverbError | null {
    return this.entries.get(`${verb}\n${version}`)?.failed ?? null;
  }

  private load(key: string, verb: string, version: number): void {
    const failed = this.entries.get(key)?.failed ?? null;
    const entry: Entry = { evaluator: null, failed, againMs: Number.POSITIVE_INFINITY };
    this.entries.delete(key);
    this.entries.set(key, entry);
    const [oldest] = this.entries.keys();
    if (this.entries.size > MOST && oldest !== undefined) this.entries.delete(oldest);
    this.client
      .verbFile(verb, { version })
      .then((content) => Evaluator.load(content))
      .then(
        (evaluator) => {
          [entry.evaluator, entry.failed] = [evaluator, null];
          this.onLoaded();
        },
        (err: unknown) => {
          entry.failed = err instanceof AdverbError ? err : new AdverbError("unknown", String(err), { cause: err });
          entry.againMs = performance.now() + AGAIN_MS;
        },
      );
  }
}
