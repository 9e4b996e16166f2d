/** One channel: sent state and the messages that bring it to its target. */

import type { Opened } from "../schema.js";
import type { Goal } from "../wire/decode.js";
import type { Motion } from "./motion.js";

/** Playback settings, which can change without reopening the channel. */
type SentState = Partial<Pick<Motion, "fps" | "playing" | "speed" | "loop" | "halfLife">> & {
  serial: number;
  adverbs: readonly number[];
};

/** The server's default, s. */
const HALF_LIFE_S = 0.1;

/** State to return to if a `switch` is refused. */
interface Before {
  identity: string;
  sent: SentState;
}

/** A text message, or a goal, which is sent together with those of other channels. */
export type Outgoing = string | Goal;

export class Channel {
  opened: Opened | null = null;
  /** Phase in the last record. */
  phase = Number.NaN;
  /** No new `open` before this time; infinite after a refusal until the target changes. */
  private retryAtMs = 0;
  /** Unanswered `open` messages; only the last answer counts. */
  private waiting = 0;
  private identity = "";
  /** Target that was refused. */
  private refusedIdentity = "";
  private sent: SentState | null = null;
  /** State before an unanswered `switch`. */
  private before: Before | null = null;
  /** Whether the last `opened` answers a `switch`: the motion continues without a discontinuity. */
  continued = false;

  constructor(readonly number: number) {}

  /** Whether the server has the channel, as far as known. */
  get isOpen(): boolean {
    return this.sent !== null;
  }

  /** Whether it is open and its records arrive. */
  get settled(): boolean {
    return this.isOpen && !this.pending && !Number.isNaN(this.phase);
  }

  /** Seconds of motion per second, as far as sent. */
  get rate(): number {
    return this.sent?.playing === false ? 0 : (this.sent?.speed ?? 1);
  }

  /** Whether its motion repeats. */
  get loop(): boolean {
    return this.sent?.loop ?? this.opened?.looping ?? false;
  }

  get pending(): boolean {
    return this.waiting > 0;
  }

  /** Whether the server has answered the last `open` or `switch` of a target. */
  has(target: Motion): boolean {
    return this.isOpen && !this.pending && this.identity === identityOf(target);
  }

  /** Messages toward the target; none if up to date or waiting for an answer. */
  next(target: Motion, adverbs: readonly number[], phase: number, nowMs: number): Outgoing[] {
    const identity = identityOf(target);
    if (this.pending || (nowMs < this.retryAtMs && this.refusedIdentity === identity)) return [];
    if (this.sent === null) return [this.open(target, adverbs, phase)];
    if (this.identity === identity) return this.changes(this.sent, target, adverbs);
    if (target.switches && this.opened?.encoding === target.encoding)
      return [this.switchVerb(this.sent, target, adverbs)];
    return [this.close(), this.open(target, adverbs, phase)];
  }

  close(): string {
    this.sent = null;
    return JSON.stringify({ op: "close", channel: this.number });
  }

  /** Handle `opened`; returns whether it answers the current target. */
  acceptOpened(opened: Opened): boolean {
    if (!opened.resumed) this.waiting = Math.max(0, this.waiting - 1);
    else if (this.before) this.resumeSwitch(this.before, opened);
    if (this.waiting > 0 || !this.sent) return false;
    this.continued = this.before !== null;
    this.before = null;
    this.opened = opened;
    // After a resume, messages sent before the disconnect may be lost.
    if (opened.resumed) this.sent = { serial: this.sent.serial, adverbs: [] };
    return true;
  }

  /**
   * Whether an error is the answer to the last `open` or `switch`. A server that does not have the channel refuses
   * settings that were sent before the `open`.
   */
  answers(code: string): boolean {
    return this.pending && (this.before !== null || code !== "unknown_channel");
  }

  /** Handle a refused `open` or `switch`; retry at a time, or if infinite only for another target. */
  refused(code: string, againMs: number): void {
    if (!this.answers(code) || --this.waiting > 0) return;
    if (code === "channel_in_use") {
      this.identity = ""; // it is closed, and opened again
      return;
    }
    this.retryAtMs = againMs;
    this.refusedIdentity = this.identity;
    this.sent = this.before?.sent ?? null;
    this.identity = this.before?.identity ?? this.identity;
    this.before = null;
  }

  /** The server no longer has the channel. */
  forget(): void {
    this.sent = null;
    this.before = null;
    this.waiting = 0;
  }

  private open(target: Motion, adverbs: readonly number[], phase: number): string {
    this.sent = { ...playing(target), serial: target.seek.serial, adverbs };
    this.identity = identityOf(target);
    this.waiting++;
    this.retryAtMs = 0;
    return JSON.stringify({
      op: "open",
      channel: this.number,
      verb: target.verb,
      ...(adverbs.length > 0 && { adverbs: adverbsByName(target.names, adverbs) }), // else the server chooses
      fps: target.fps,
      ...(target.method && { method: target.method }),
      encoding: target.encoding,
      ...(target.encoding === "weights" && { send: "changes" }),
      phase,
      speed: target.speed,
      play: target.playing,
      ...(target.loop !== undefined && { loop: target.loop }),
      ...(target.halfLife !== undefined && { half_life: target.halfLife }),
      ...target.options,
    });
  }

  /** Phase and duration of the transition are chosen by the server; the new motion plays, and loops if its verb does. */
  private switchVerb(sent: SentState, target: Motion, adverbs: readonly number[]): string {
    this.before = { identity: this.identity, sent };
    const { loop: _, ...rest } = playing(target);
    this.sent = { ...rest, playing: true, serial: target.seek.serial, adverbs };
    this.identity = identityOf(target);
    this.waiting++;
    return JSON.stringify({
      op: "switch",
      channel: this.number,
      verb: target.verb,
      ...(adverbs.length > 0 && { adverbs: adverbsByName(target.names, adverbs) }),
      ...(target.method && { method: target.method }),
      ...(target.transitionS !== undefined && { transition_s: target.transitionS }),
    });
  }

  /** After a disconnect the answer to a `switch` is lost; the resumed channel shows whether it took effect. */
  private resumeSwitch({ identity, sent }: Before, opened: Opened): void {
    this.waiting = 0;
    if (this.identity.startsWith(`${opened.verb}\n`)) return;
    [this.identity, this.sent] = [identity, sent];
  }

  private changes(sent: SentState, target: Motion, adverbs: readonly number[]): Outgoing[] {
    const set: Record<string, unknown> = {};
    if (sent.fps !== target.fps) set.fps = target.fps;
    if (sent.speed !== target.speed) set.speed = target.speed;
    if (sent.playing !== target.playing) set.play = target.playing;
    if (target.loop !== undefined && sent.loop !== target.loop) set.loop = target.loop;
    if (sent.halfLife !== target.halfLife) set.half_life = target.halfLife ?? HALF_LIFE_S;
    if (sent.serial !== target.seek.serial) set.phase = target.seek.phase;
    const moved =
      adverbs.length > 0 &&
      (adverbs.length !== sent.adverbs.length || adverbs.some((value, k) => value !== sent.adverbs[k]));
    this.sent = { ...playing(target), serial: target.seek.serial, adverbs };
    const out: Outgoing[] = [];
    if (moved) out.push({ channel: this.number, adverbs });
    if (Object.keys(set).length > 0) out.push(JSON.stringify({ op: "set", channel: this.number, ...set }));
    return out;
  }
}

function playing({ fps, playing, speed, loop, halfLife }: Motion) {
  return { fps, playing, speed, ...(loop !== undefined && { loop }), ...(halfLife !== undefined && { halfLife }) };
}

/** Settings that require reopening or, if the target allows it, a `switch`. */
function identityOf(target: Motion): string {
  return [target.verb, target.method, target.encoding, target.switchSerial].join("\n");
}

function adverbsByName(names: readonly string[], values: readonly number[]): Record<string, number> {
  return Object.fromEntries(names.map((name, k) => [name, values[k] ?? 0]));
}
