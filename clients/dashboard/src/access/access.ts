/** The key of this tab, what it permits, and the requests that wait for another key. */

import type { components } from "adverb-client";
import { AdverbError } from "adverb-client";

/** Holder of a key, as in `GET /v1/access`. */
export type Caller = components["schemas"]["AccessAnswer"];
export type Scope = "pose" | "author" | "refine" | "admin";

const ITEM = "adverb.key";
/** Characters of keys and tokens; others cannot be sent in a header or as a subprotocol. */
const FORM = /^[\w.~+-]+$/;

/**
 * @param storage of this tab; null keeps the key in memory
 * @param find requests the holder of a key; throws a `AdverbError`
 */
export class Access {
  key: string;
  /** Null until the server has responded, and while a key is needed. */
  caller: Caller | null = null;
  /** Why the page needs a key; null: it does not. */
  problem: string | null = null;
  private readonly waiting = new Set<() => void>();
  private readonly listeners = new Set<() => void>();

  constructor(
    private readonly storage: Pick<Storage, "getItem" | "setItem" | "removeItem"> | null,
    private readonly find: (key: string) => Promise<Caller>,
  ) {
    this.key = storage?.getItem(ITEM) ?? "";
  }

  /** Call `then` after every change; returns the unsubscribe function. */
  on(then: () => void): () => void {
    this.listeners.add(then);
    return () => this.listeners.delete(then);
  }

  /** Whether the key has a scope; also while that is not known, so that the server decides. */
  may(scope: Scope): boolean {
    const { caller } = this;
    return caller === null || caller.scopes.includes(scope) || caller.scopes.includes("admin");
  }

  /** The key for a request; waits while the page needs another one. */
  async usable(signal?: AbortSignal | null): Promise<string> {
    signal?.throwIfAborted();
    if (this.problem !== null) await this.wait(signal);
    return this.key;
  }

  /** The server refused a key: prompt for another, unless that has happened since. */
  refuse(key: string, problem: string): void {
    if (key !== this.key || this.problem !== null) return;
    this.problem = problem;
    this.caller = null;
    this.emit();
  }

  /** Request who the holder of the current key is. */
  async load(): Promise<void> {
    const key = await this.usable();
    const caller = await this.find(key).catch((err: unknown) => {
      if (!(err instanceof AdverbError) || err.status !== 401) throw err;
      this.refuse(key, err.detail);
      return null;
    });
    if (caller === null || key !== this.key || this.problem !== null) return;
    this.caller = caller;
    this.emit();
  }

  /** Use another key if the server accepts it; throws if not. */
  async give(text: string): Promise<void> {
    const key = text.trim();
    if (!FORM.test(key)) throw new Error("A key consists of letters, digits, “_”, “-” and “.”, without blanks.");
    this.caller = await this.find(key);
    this.key = key;
    this.problem = null;
    this.storage?.setItem(ITEM, key);
    this.emit();
    for (const proceed of [...this.waiting]) proceed();
  }

  /** Remove the key from this tab. */
  forget(): void {
    this.key = "";
    this.caller = null;
    this.storage?.removeItem(ITEM);
    this.emit();
  }

  private wait(signal?: AbortSignal | null): Promise<void> {
    return new Promise((done, failed) => {
      const end = () => {
        this.waiting.delete(proceed);
        signal?.removeEventListener("abort", abort);
      };
      const abort = () => {
        end();
        failed(signal?.reason);
      };
      const proceed = () => {
        end();
        done();
      };
      this.waiting.add(proceed);
      signal?.addEventListener("abort", abort, { once: true });
    });
  }

  private emit(): void {
    for (const then of [...this.listeners]) then();
  }
}

/** Storage of this tab; null where the browser denies it. */
export function tabStorage(): Storage | null {
  try {
    return sessionStorage;
  } catch {
    return null;
  }
}
