/** One channel: what the server was told of it, and what it must be told next to become what is wished. */

import type { Opened } from "../types";
import { writeAdverbs } from "./decode";
import type { Motion } from "./worker_messages";

/** Ways of playing that are told apart from the rest, since they change without opening anew. */
type Told = Partial<Pick<Motion, "fps" | "playing" | "speed" | "loop">> & {
  serial: number;
  adverbs: readonly number[];
};

export type Outgoing = string | ArrayBuffer;

export class Channel {
  opened: Opened | null = null;
  /** Where it was in the last record. */
  phase = Number.NaN;
  /** Not asked for again before this time; after a refusal not before something else is wished. */
  private notBeforeMs = 0;
  /** Calls of `open` that are not answered yet; only the answer to the last one counts. */
  private waiting = 0;
  private identity = "";
  private told: Told | null = null;

  constructor(readonly number: number) {}

  /** Whether the server has it, as far as this page knows. */
  get there(): boolean {
    return this.told !== null;
  }

  /** Whether it is open, and its records come. */
  get settled(): boolean {
    return this.there && !this.pending && !Number.isNaN(this.phase);
  }

  get pending(): boolean {
    return this.waiting > 0;
  }

  /** The messages that bring it to what is wished; none where it is there, or waits for an answer. */
  next(wish: Motion, adverbs: readonly number[], phase: number, nowMs: number): Outgoing[] {
    if (this.pending || (nowMs < this.notBeforeMs && this.identity === identityOf(wish))) return [];
    if (this.told === null) return [this.open(wish, adverbs, phase)];
    if (this.identity !== identityOf(wish)) return [this.close(), this.open(wish, adverbs, phase)];
    return this.changes(this.told, wish, adverbs);
  }

  close(): Outgoing {
    this.told = null;
    return JSON.stringify({ op: "close", channel: this.number });
  }

  /** Take the answer to `open` or to a resume; whether it is about what is wished, and not about an earlier wish. */
  answered(opened: Opened): boolean {
    if (!opened.resumed) this.waiting = Math.max(0, this.waiting - 1);
    if (this.waiting > 0 || !this.told) return false;
    this.opened = opened;
    // Taken up again: the last messages before the connection broke may have been lost.
    if (opened.resumed) this.told = { serial: this.told.serial, adverbs: [] };
    return true;
  }

  /** The server refused to open it; ask again at a time, or where that is infinite, for something else only. */
  refused(againMs: number): void {
    if (this.waiting === 0 || --this.waiting > 0) return;
    this.told = null;
    this.notBeforeMs = againMs;
  }

  /** The server does not have it any more. */
  forgotten(): void {
    this.told = null;
    this.waiting = 0;
  }

  private open(wish: Motion, adverbs: readonly number[], phase: number): Outgoing {
    this.told = { ...playing(wish), serial: wish.seek.serial, adverbs };
    this.identity = identityOf(wish);
    this.waiting++;
    this.notBeforeMs = 0;
    return JSON.stringify({
      op: "open",
      channel: this.number,
      verb: wish.verb,
      ...(adverbs.length > 0 && { adverbs: byName(wish.names, adverbs) }), // else the server chooses
      fps: wish.fps,
      ...(wish.method && { method: wish.method }),
      encoding: wish.encoding,
      phase,
      speed: wish.speed,
      play: wish.playing,
      loop: wish.loop,
    });
  }

  private changes(told: Told, wish: Motion, adverbs: readonly number[]): Outgoing[] {
    const set: Record<string, unknown> = {};
    if (told.fps !== wish.fps) set.fps = wish.fps;
    if (told.speed !== wish.speed) set.speed = wish.speed;
    if (told.playing !== wish.playing) set.play = wish.playing;
    if (told.loop !== wish.loop) set.loop = wish.loop;
    if (told.serial !== wish.seek.serial) set.phase = wish.seek.phase;
    const moved =
      adverbs.length > 0 &&
      (adverbs.length !== told.adverbs.length || adverbs.some((value, k) => value !== told.adverbs[k]));
    this.told = { ...playing(wish), serial: wish.seek.serial, adverbs };
    const out: Outgoing[] = [];
    if (moved) out.push(writeAdverbs(this.number, adverbs));
    if (Object.keys(set).length > 0) out.push(JSON.stringify({ op: "set", channel: this.number, ...set }));
    return out;
  }
}

function playing({ fps, playing, speed, loop }: Motion) {
  return { fps, playing, speed, loop };
}

/** What cannot be changed without opening anew: `switch` would put the figure elsewhere than its goal. */
function identityOf(wish: Motion): string {
  return [wish.verb, wish.method, wish.encoding].join("\n");
}

function byName(names: readonly string[], values: readonly number[]): Record<string, number> {
  return Object.fromEntries(names.map((name, k) => [name, values[k] ?? 0]));
}
