/** The page without its looks: what is served, what is wanted, what is shown. */

import { Problem } from "./api/rest";
import { OtherVersion } from "./comparison";
import { crowdGoals } from "./crowd";
import { Emitter } from "./emitter";
import { Hold } from "./pause_at_goal";
import type {
  App,
  AppEvents,
  Connection,
  Opened,
  Picture,
  Rest,
  Shown,
  Side,
  Stats,
  Store,
  Verb,
  VerbSummary,
} from "./types";
import { byName, effectorPhase, holdPhase, inOrder } from "./verb";
import { type Heard, type Port, StreamClient } from "./wire/client";
import type { Drawn, Motion, Seek } from "./wire/worker_messages";

const FIRST_CHOICE = "reach";
const RETRY_MS = 2000;
const DIGITS = 4;

/** What only the shell hears: pictures to draw, things to say, how the first answer is getting on. */
interface Within extends AppEvents {
  picture: { side: Side; picture: Picture | null };
  say: { text: string; kind: "note" | "error" };
  hold: number | null;
  offline: { detail: string; againInS: number };
}

export class Page implements App {
  verbs: readonly VerbSummary[] = [];
  verb: Verb | null = null;
  opened: Opened | null = null;
  connection: Connection = "connecting";
  stats: Stats | null = null;
  /** Whether the server has told its verbs, be there any or none. */
  answered = false;
  readonly shown: Record<Side, Shown | null> = { main: null, other: null };
  readonly hold = new Hold(() => this.held());
  private readonly emitter = new Emitter<Within>();
  private readonly stream: StreamClient;
  private readonly version: OtherVersion;
  private seeking: Seek;
  private wanted = "";
  private loading = "";

  constructor(
    readonly store: Store,
    readonly rest: Rest,
    port: Port,
    private readonly still: boolean,
  ) {
    this.stream = new StreamClient(
      port,
      (message) => this.heard(message),
      (pictures) => this.drawn(pictures),
    );
    this.version = new OtherVersion(rest, (err) => this.refusedOther(err));
    this.version.again = () => this.version.want(this.store.view, this.verb);
    store.on(["verb"], () => void this.load());
    store.on(["goal"], () => this.completeGoal());
    this.seeking = { serial: 0, phase: store.view.phase };
    store.on(["playing", "phase"], (view, before) => {
      this.hold.release();
      if (!view.playing || view.phase !== before.phase) this.goTo(view.phase);
    });
  }

  on<Name extends keyof Within>(event: Name, then: (what: Within[Name]) => void): () => void {
    return this.emitter.on(event, then);
  }

  say(text: string, kind: "note" | "error" = "note"): void {
    this.emitter.emit("say", { text, kind });
  }

  start(address: string): void {
    this.stream.start(address);
    void this.reload();
  }

  stop(): void {
    this.stream.stop();
  }

  /** An animation frame: bring the stream to what is wanted now, and ask for a picture. */
  frame(frameMs: number): void {
    this.want();
    this.stream.draw(frameMs);
  }

  async reload(): Promise<void> {
    try {
      this.verbs = await this.rest.verbs();
    } catch {
      // The stream says that nobody answers; this only has to try again.
      setTimeout(() => void this.reload(), RETRY_MS);
      return;
    }
    this.answered = true;
    this.emitter.emit("verbs", this.verbs);
    const { verb } = this.store.view;
    const known = this.verbs.find(({ name }) => name === verb);
    if (known) return this.load();
    if (verb) this.say(`The verb “${verb}” is not served here.`, "error");
    this.choose((this.verbs.find(({ name }) => name === FIRST_CHOICE) ?? this.verbs[0])?.name ?? "");
  }

  /** Show another verb, from its own beginning. */
  choose(verb: string): void {
    if (verb === this.store.view.verb) return;
    const none = { method: "", goal: {}, phase: 0, camera: null, across: "", up: "", slice: null };
    this.store.change({ verb, ...none, against: { kind: "nothing" } });
  }

  /** The goal was moved by hand: follow it there. */
  aim(goal: Readonly<Record<string, number>>, done: boolean): void {
    const { view } = this.store;
    const rounded = Object.entries(goal).map(([name, value]) => [name, round(value)]);
    this.store.change({ goal: { ...view.goal, ...Object.fromEntries(rounded) } });
    if (view.playing && this.verb) this.hold.move(holdPhase(this.verb, this.opened), done);
  }

  pause(): void {
    const phase = this.hold.phase ?? this.shown.main?.phase ?? this.store.view.phase;
    this.store.change({ playing: false, phase: round(Math.min(Math.max(phase, 0), 1)) });
  }

  play(): void {
    const { phase, loop, speed } = this.store.view;
    const ended = !loop && (speed < 0 ? phase <= 0 : phase >= 1);
    this.store.change({ playing: true, ...(ended && { phase: speed < 0 ? 1 : 0 }) });
  }

  /** Stand at another phase. */
  seek(phase: number): void {
    this.store.change({ playing: false, phase: round(Math.min(Math.max(phase, 0), 1)) });
  }

  private async load(): Promise<void> {
    const { verb: name } = this.store.view;
    this.loading = name;
    if (!name) return;
    try {
      const verb = await this.rest.verb(name);
      if (this.loading === name) this.show(verb);
    } catch (err) {
      if (this.loading !== name) return;
      if (err instanceof Problem && err.status === 0) setTimeout(() => void this.load(), RETRY_MS);
      else this.say(textOf(err), "error");
    }
  }

  private show(verb: Verb): void {
    const other = this.verb?.name !== verb.name;
    this.verb = verb;
    if (other) {
      this.opened = null;
      this.shown.main = this.shown.other = null;
    }
    const { view } = this.store;
    const { against } = view;
    if (view.method && !verb.methods.includes(view.method)) this.store.change({ method: "" });
    if (against.kind === "method" && !verb.methods.includes(against.method))
      this.store.change({ against: { kind: "nothing" } });
    if (other && this.still && !view.playing && view.phase === 0)
      this.store.change({ phase: round(effectorPhase(verb) ?? 0.5) });
    this.emitter.emit("verb", verb);
    this.want();
  }

  private want(): void {
    const { verb } = this;
    const { view } = this.store;
    if (!verb || verb.name !== view.verb) return;
    const goal = inOrder(verb, view.goal);
    const main: Motion = {
      verb: verb.name,
      method: view.method,
      names: verb.adverbs.map(({ name }) => name),
      fps: view.fps,
      encoding: view.encoding,
      playing: view.playing && this.hold.phase === null,
      speed: view.speed,
      loop: view.loop,
      seek: this.seeking,
    };
    const other = view.against.kind === "method" ? { ...main, method: view.against.method } : null;
    const key = JSON.stringify([main, goal, view.crowd, other, verb.version]);
    if (key === this.wanted) return;
    this.wanted = key;
    this.stream.want({ main, adverbs: crowdGoals(verb, goal, view.crowd), other });
    this.version.want(view, verb);
  }

  private goTo(phase: number): void {
    this.seeking = { serial: this.seeking.serial + 1, phase };
  }

  private held(): void {
    if (this.hold.phase !== null) this.goTo(this.hold.phase);
    this.emitter.emit("hold", this.hold.phase);
  }

  private heard(message: Heard): void {
    switch (message.kind) {
      case "connection":
        return this.connected(message);
      case "opened":
        return this.answer(message.side, message.opened);
      case "stats":
        this.stats = message.stats;
        return this.emitter.emit("stats", message.stats);
      case "event":
        return this.emitter.emit("event", message);
      case "end":
        return this.ended();
      case "version":
        if (this.opened?.verb === message.verb) this.opened = { ...this.opened, version: message.version };
        return void this.reload();
      case "refused":
        if (message.side === "other") return this.refusedOther(new Error(message.detail));
        return this.say(message.detail, "error");
    }
  }

  private connected({ connection, detail, againInS }: Extract<Heard, { kind: "connection" }>): void {
    const back = connection === "open" && this.connection === "lost";
    this.connection = connection;
    this.emitter.emit("connection", connection);
    if (connection !== "open") this.emitter.emit("offline", { detail, againInS });
    if (back) void this.reload();
  }

  private answer(side: Side, opened: Opened): void {
    if (side === "other") return;
    this.opened = opened;
    this.emitter.emit("opened", opened);
    const { verb } = this;
    if (verb?.name !== opened.verb) return;
    if (opened.version !== verb.version) void this.reload();
    this.completeGoal();
  }

  /** A link may hold no goal, or one of another verb: then it is the one that the server chose. */
  private completeGoal(): void {
    const { verb, opened } = this;
    const { view } = this.store;
    if (!verb || verb.name !== view.verb || verb.name !== opened?.verb || inOrder(verb, view.goal).length > 0) return;
    this.store.change({
      goal: byName(
        verb,
        opened.adverbs.map((adverb) => round(adverb.goal)),
      ),
    });
  }

  /** A motion that does not loop has reached its end, and holds there. */
  private ended(): void {
    const { view } = this.store;
    if (view.playing && !view.loop) this.store.change({ playing: false, phase: view.speed < 0 ? 0 : 1 });
  }

  private drawn(pictures: Record<Side, Drawn | null>): void {
    const { main, other } = pictures;
    const { verb } = this;
    if (!main || !verb || main.shown.verb !== verb.name || (other && other.shown.verb !== verb.name)) return;
    this.shown.main = main.shown;
    this.emitter.emit("picture", { side: "main", picture: pictureOf(main) });
    const beside = this.version.beside(main.shown, main.poses, verb.looping);
    this.shown.other = beside?.shown ?? other?.shown ?? null;
    const picture = beside?.picture ?? (other ? pictureOf(other) : null);
    this.emitter.emit("picture", { side: "other", picture });
    this.emitter.emit("frame", main.shown);
  }

  private refusedOther(err: unknown): void {
    this.store.change({ against: { kind: "nothing" } });
    this.say(`Nothing to compare with: ${textOf(err)}`, "error");
  }
}

function pictureOf({ shown, poses }: Drawn): Picture {
  return { count: shown.count, poses, error: shown.error, phase: shown.phase };
}

/** Enough digits for a tenth of a millimetre, and links that can be read. */
function round(value: number): number {
  return Number(value.toFixed(DIGITS));
}

export function textOf(err: unknown): string {
  return err instanceof Problem ? err.detail : err instanceof Error ? err.message : String(err);
}
