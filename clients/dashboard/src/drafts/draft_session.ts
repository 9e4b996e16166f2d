/**
 * State of an open draft: edits are shown at once, sent after a short delay, and joined while a request runs.
 *
 * Every request names the revision that it changes. If another client changed the draft, it is loaded again and the
 * edit is dropped with a message.
 */

import { AdverbError, Emitter } from "adverb-client";
import { applied, joined } from "./edits";
import type { Draft, DraftEdit, DraftRest } from "./types";

const SEND_AFTER_MS = 120;

interface Events {
  /** The displayed draft changed. */
  draft: Draft;
  /** The server's draft changed: its verb may differ. */
  saved: Draft;
  /** An edit failed; empty after a success. */
  problem: string;
  saving: boolean;
}

export class DraftSession {
  private saved: Draft;
  private waiting: DraftEdit | null = null;
  private sent: DraftEdit | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private closed = false;
  private held = false;
  private readonly emitter = new Emitter<Events>();
  private readonly idle: (() => void)[] = [];

  constructor(
    private readonly rest: DraftRest,
    draft: Draft,
  ) {
    this.saved = draft;
  }

  on<Name extends keyof Events>(event: Name, then: (event: Events[Name]) => void): () => void {
    return this.emitter.on(event, then);
  }

  /** The draft with all edits, saved or not. */
  get draft(): Draft {
    return applied(applied(this.saved, this.sent), this.waiting);
  }

  get saving(): boolean {
    return this.sent !== null || this.waiting !== null;
  }

  edit(edit: DraftEdit): void {
    this.waiting = this.waiting ? joined(this.waiting, edit) : edit;
    clearTimeout(this.timer);
    if (!this.held) this.timer = setTimeout(() => void this.send(), SEND_AFTER_MS);
    this.emitter.emit("draft", this.draft);
    this.emitter.emit("saving", true);
  }

  /** Keep edits while a handle is dragged; at its release they are sent at once. */
  hold(on: boolean): void {
    this.held = on;
    clearTimeout(this.timer);
    if (!on) void this.send();
  }

  /** Resolves when no edit waits or runs. */
  async settled(): Promise<void> {
    this.hold(false);
    if (this.saving) await new Promise<void>((done) => this.idle.push(done));
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    if (this.waiting && !this.sent)
      void this.rest.change(this.saved.id, this.waiting, this.saved.revision).catch(() => {});
  }

  private async send(): Promise<void> {
    if (this.sent || this.held || !this.waiting) return;
    this.sent = this.waiting;
    this.waiting = null;
    let problem = "";
    try {
      this.saved = await this.rest.change(this.saved.id, this.sent, this.saved.revision);
    } catch (err) {
      problem = await this.failed(err);
    }
    this.sent = null;
    if (this.closed) return;
    this.emitter.emit("saved", this.saved);
    this.emitter.emit("draft", this.draft);
    this.emitter.emit("problem", problem);
    if (this.waiting) return void this.send();
    this.emitter.emit("saving", false);
    for (const done of this.idle.splice(0)) done();
  }

  /** Message of a failed edit; loads the draft again where its revision is another. */
  private async failed(err: unknown): Promise<string> {
    if (!(err instanceof AdverbError)) return String(err);
    if (err.status !== 412) return err.detail;
    this.waiting = null;
    try {
      this.saved = await this.rest.get(this.saved.id);
    } catch (again) {
      return again instanceof AdverbError ? again.detail : String(again);
    }
    return "Another client changed this draft. It was loaded again; the last change was not saved.";
  }
}
