/** State and behaviour of the page without its DOM: served verbs, requested view, displayed figures. */

import type { Drawn, Motion, Seek } from "adverb-client";
import { AdverbError, Emitter, retryMs } from "adverb-client";
import type { Access } from "./access/access";
import { VersionComparison } from "./comparison";
import { crowdGoals } from "./crowd";
import { DRIVEN_VERB, Drive } from "./drive/drive";
import { axesOf } from "./drive/steering";
import { PauseAtGoal } from "./pause_at_goal";
import { same } from "./store";
import type {
  App,
  AppEvents,
  Connection,
  CrowdPlaces,
  Opened,
  Picture,
  Rest,
  Role,
  Shown,
  Stats,
  Store,
  Verb,
  VerbSummary,
} from "./types";
import { adverbsByName, adverbValues, effectorPhase, followPhase } from "./verb";
import { Walkers } from "./walkers";
import { type Port, StreamClient, type StreamEvent } from "./wire/client";

const DEFAULT_VERB = "reach";
const RETRY_MS = 2000;
/** Interval at which the list of verbs is compared with the server. */
const REFRESH_MS = 5000;
const DIGITS = 4;
/** Rate of the stream while a draft covers the figure, frames per second. */
const BACKGROUND_FPS = 1;

/** Events for the shell only: pictures to draw, notices, pause and connection state. */
interface PageEvents extends AppEvents {
  picture: { role: Role; picture: Picture | null };
  notice: { text: string; kind: "note" | "error" };
  pause: number | null;
  /** The actions of drive mode changed. */
  actions: null;
  offline: { detail: string; againInS: number };
}

export class Page implements App {
  verbs: readonly VerbSummary[] = [];
  verb: Verb | null = null;
  opened: Opened | null = null;
  connection: Connection = "connecting";
  stats: Stats | null = null;
  /** Whether the list of verbs has been loaded. */
  loaded = false;
  readonly shown: Record<Role, Shown | null> = { main: null, comparison: null };
  readonly pauseAtGoal = new PauseAtGoal(() => this.onPauseChange());
  readonly drive: Drive;
  private readonly emitter = new Emitter<PageEvents>();
  private readonly walkers = new Walkers();
  private distant: readonly boolean[] | null = null;
  private readonly stream: StreamClient;
  private readonly version: VersionComparison;
  private seekRequest: Seek;
  private targetKey = "";
  private loading = "";
  private refreshTimer: ReturnType<typeof setInterval> | undefined;
  private refreshing = false;
  /** Time before which the list of verbs is not requested, ms. */
  private refreshAtMs = 0;

  constructor(
    readonly store: Store,
    readonly rest: Rest,
    readonly access: Access,
    port: Port,
    private readonly reducedMotion: boolean,
  ) {
    this.stream = new StreamClient(
      port,
      (message) => this.onStreamEvent(message),
      (pictures) => this.onPictures(pictures),
    );
    this.version = new VersionComparison(rest, (err) => this.comparisonFailed(err));
    this.version.onSettled = () => this.version.setTarget(this.store.view, this.verb);
    store.on(["verb"], () => void this.load());
    store.on(["draft"], ({ draft }) => !draft && void this.reload());
    store.on(["goal"], () => this.completeGoal());
    this.drive = new Drive(this);
    this.drive.onActions = () => this.emitter.emit("actions", null);
    this.seekRequest = { serial: 0, phase: store.view.phase };
    store.on(["playing", "phase"], (view, before) => {
      this.pauseAtGoal.release();
      if (!view.playing || view.phase !== before.phase) this.seekTo(view.phase);
    });
  }

  on<Name extends keyof PageEvents>(event: Name, then: (event: PageEvents[Name]) => void): () => void {
    return this.emitter.on(event, then);
  }

  notify(text: string, kind: "note" | "error" = "note"): void {
    this.emitter.emit("notice", { text, kind });
  }

  start(address: string): void {
    this.stream.start(address, this.streamKey);
    this.access.on(() => {
      this.stream.setKey(this.streamKey);
      this.emitter.emit("access", null);
    });
    this.loadAccess();
    this.refreshTimer = setInterval(() => void this.refresh(), REFRESH_MS);
    void this.reload();
  }

  /** Key of the stream; null while another is needed, or if this one does not permit streams. */
  private get streamKey(): string | null {
    return this.access.problem !== null || !this.access.may("pose") ? null : this.access.key;
  }

  /** Request what the key permits; until that is known, the server refuses what it does not. */
  private loadAccess(): void {
    this.access.load().catch((err: unknown) => setTimeout(() => this.loadAccess(), retryMs(err, RETRY_MS)));
  }

  /** Remove the key from this tab; the prompt appears if the server needs one. */
  forgetKey(): void {
    this.access.forget();
    this.loadAccess();
  }

  stop(): void {
    clearInterval(this.refreshTimer);
    this.stream.stop();
  }

  /** Update the stream's target and request a picture; call once per animation frame. */
  frame(frameMs: number): void {
    if (this.store.view.draft) return this.updateTarget();
    this.drive.frame();
    this.updateTarget();
    this.stream.draw(frameMs);
  }

  /** Steer the characters of a crowd that walk; call with the displayed places. */
  moveCrowd({ count, places, distant }: CrowdPlaces, nowMs: number): void {
    const { verb, store } = this;
    const axes = verb && count === store.view.crowd && store.view.playing ? axesOf(verb) : null;
    const moved = axes ? this.walkers.update(axes, places, count, nowMs) : this.walkers.clear();
    if (!moved && distant === this.distant) return;
    this.distant = distant;
    this.targetKey = "";
  }

  async reload(): Promise<void> {
    try {
      this.verbs = await this.rest.verbs();
    } catch (err) {
      // The connection state is shown by the overlay; only retry here.
      if (err instanceof AdverbError && err.retryMs > 0) this.notify(err.detail);
      setTimeout(() => void this.reload(), retryMs(err, RETRY_MS));
      return;
    }
    this.emitter.emit("verbs", this.verbs);
    if (this.leaveMissing()) return;
    await this.load();
  }

  /** Follow changes of the served verbs by other clients; does nothing if there are none or no response. */
  async refresh(): Promise<void> {
    if (!this.loaded || this.refreshing || performance.now() < this.refreshAtMs) return;
    this.refreshing = true;
    const verbs = await this.rest.verbs().catch((err: unknown) => {
      this.refreshAtMs = performance.now() + retryMs(err, 0);
      return this.verbs;
    });
    this.refreshing = false;
    if (same(verbs, this.verbs)) return;
    this.verbs = verbs;
    this.emitter.emit("verbs", verbs);
    const served = verbs.find(({ name }) => name === this.verb?.name);
    if (!this.leaveMissing() && served?.version !== this.verb?.version) await this.load();
  }

  /** Select the default verb if the selected one does not exist; returns whether it did. */
  private leaveMissing(): boolean {
    const { verb } = this.store.view;
    if (this.verbs.some(({ name }) => name === verb)) {
      this.loaded = true;
      return false;
    }
    const deleted = this.loaded && this.verb?.name === verb;
    const first = !this.loaded && !verb;
    if (!verb && this.store.view.draft) return true;
    this.loaded = true;
    if (first && !this.reducedMotion && this.canDrive) {
      this.startDriving(false);
      return true;
    }
    const next = (this.verbs.find(({ name }) => name === DEFAULT_VERB) ?? this.verbs[0])?.name ?? "";
    if (verb) this.notify(`Verb “${verb}” ${deleted ? "was deleted" : "does not exist on this server"}.`, "error");
    this.selectVerb(next, false);
    return true;
  }

  /** Whether the verb that drive mode steers is served. */
  get canDrive(): boolean {
    return this.verbs.some(({ name }) => name === DRIVEN_VERB);
  }

  /** Start drive mode, with the current verb if it can be driven. */
  startDriving(push = true): void {
    const { verb } = this.store.view;
    if (this.verb?.name !== verb || !axesOf(this.verb)) this.selectVerb(DRIVEN_VERB, push);
    this.store.change({ drive: true, compare: { kind: "none" }, camera: null });
  }

  stopDriving(): void {
    this.store.change({ drive: false, playing: true, camera: null });
  }

  /** Select another verb and reset the view of the previous one; `push` adds a history entry. */
  selectVerb(verb: string, push = true): void {
    if (verb === this.store.view.verb) return;
    const none = { method: "", goal: {}, phase: 0, camera: null, across: "", up: "", slice: null, drive: false };
    this.store.change({ verb, ...none, compare: { kind: "none" } }, push);
  }

  /** Set the goal from user input; pauses a playing motion at the goal's keytime. */
  setGoal(goal: Readonly<Record<string, number>>, done: boolean): void {
    const { view } = this.store;
    const rounded = Object.entries(goal).map(([name, value]) => [name, round(value)]);
    this.store.change({ goal: { ...view.goal, ...Object.fromEntries(rounded) } });
    if (view.playing && this.verb) this.pauseAtGoal.move(followPhase(this.verb, this.opened), done);
  }

  pause(): void {
    const phase = this.pauseAtGoal.phase ?? this.shown.main?.phase ?? this.store.view.phase;
    this.store.change({ playing: false, phase: round(Math.min(Math.max(phase, 0), 1)) });
  }

  play(): void {
    const { phase, loop, speed } = this.store.view;
    const ended = !loop && (speed < 0 ? phase <= 0 : phase >= 1);
    this.store.change({ playing: true, ...(ended && { phase: speed < 0 ? 1 : 0 }) });
  }

  /** Pause at a phase. */
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
      const offline = err instanceof AdverbError && err.status === 0;
      const limited = err instanceof AdverbError && err.retryMs > 0;
      if (offline || limited) setTimeout(() => this.loading === name && void this.load(), retryMs(err, RETRY_MS));
      if (offline) return;
      if (err instanceof AdverbError && err.code === "unknown_verb") await this.refresh();
      if (this.store.view.verb === name) this.notify(textOf(err), limited ? "note" : "error");
    }
  }

  private show(verb: Verb): void {
    const changed = this.verb?.name !== verb.name;
    this.verb = verb;
    if (changed) {
      this.opened = null;
      this.shown.main = this.shown.comparison = null;
    }
    const { view } = this.store;
    const { compare } = view;
    if (view.method && !verb.methods.includes(view.method)) this.store.change({ method: "" });
    if (compare.kind === "method" && !verb.methods.includes(compare.method))
      this.store.change({ compare: { kind: "none" } });
    if (changed && this.reducedMotion && !view.playing && view.phase === 0)
      this.store.change({ phase: round(effectorPhase(verb) ?? 0.5) });
    this.emitter.emit("verb", verb);
    this.completeGoal();
    this.updateTarget();
  }

  private updateTarget(): void {
    const { verb } = this;
    const { view } = this.store;
    if (!verb || verb.name !== view.verb) return;
    const goal = adverbValues(verb, view.goal);
    const crowd: Motion = {
      verb: verb.name,
      method: view.method,
      names: verb.adverbs.map(({ name }) => name),
      fps: view.draft ? BACKGROUND_FPS : view.fps,
      encoding: view.encoding,
      playing: view.playing && !view.draft && this.pauseAtGoal.phase === null,
      speed: view.speed,
      loop: view.loop,
      seek: this.seekRequest,
    };
    const { active, action } = this.drive;
    const main = active ? this.drive.motion(crowd) : crowd;
    const steered = action?.adverbs ?? goal;
    const comparison = view.compare.kind === "method" && !active ? { ...main, method: view.compare.method } : null;
    const poses = view.crowdPoses;
    const key = JSON.stringify([main, steered, view.crowd, poses, comparison, verb.version]);
    if (key === this.targetKey) return;
    this.targetKey = key;
    const { goals } = this.walkers;
    const others =
      goals.length === view.crowd - 1
        ? goals.map((own) => adverbValues(verb, { ...view.goal, ...own }))
        : crowdGoals(verb, goal, view.crowd).slice(1);
    const distant = this.distant ? { distant: this.distant } : {};
    const adverbs = [[...steered], ...others];
    this.stream.setTarget({ main, crowd, adverbs, comparison, weights: !poses, ...distant });
    this.version.setTarget(view, verb);
  }

  private seekTo(phase: number): void {
    this.seekRequest = { serial: this.seekRequest.serial + 1, phase };
  }

  private onPauseChange(): void {
    if (this.pauseAtGoal.phase !== null) this.seekTo(this.pauseAtGoal.phase);
    this.emitter.emit("pause", this.pauseAtGoal.phase);
  }

  private onStreamEvent(message: StreamEvent): void {
    switch (message.kind) {
      case "connection":
        return this.onConnection(message);
      case "unauthenticated":
        this.access.refuse(message.key, message.detail);
        return this.stream.setKey(this.streamKey);
      case "opened":
        return this.onOpened(message.role, message.opened);
      case "stats":
        this.stats = message.stats;
        return this.emitter.emit("stats", message.stats);
      case "event":
        return this.emitter.emit("event", message);
      case "end":
        return this.onEnd();
      case "version":
        if (this.opened?.verb === message.verb) this.opened = { ...this.opened, version: message.version };
        return void this.reload();
      case "refused":
        if (message.role === "comparison") return this.comparisonFailed(new Error(message.detail));
        if (this.drive.action) this.drive.end();
        if (message.code === "unknown_verb") return void this.refresh();
        return this.notify(message.detail, "error");
    }
  }

  private onConnection({ connection, detail, againInS }: Extract<StreamEvent, { kind: "connection" }>): void {
    const back = connection === "open" && this.connection === "lost";
    this.connection = connection;
    this.emitter.emit("connection", connection);
    if (connection !== "open") this.emitter.emit("offline", { detail, againInS });
    if (back) void this.reload();
  }

  private onOpened(role: Role, opened: Opened): void {
    if (role === "comparison") return;
    this.opened = opened;
    this.emitter.emit("opened", opened);
    const { verb } = this;
    if (verb?.name !== opened.verb) return;
    if (opened.version !== verb.version) void this.reload();
    this.completeGoal();
  }

  /** Fill in the server's default goal when the link has no goal for this verb. */
  private completeGoal(): void {
    const { verb, opened } = this;
    const { view } = this.store;
    if (!verb || verb.name !== view.verb || verb.name !== opened?.verb || adverbValues(verb, view.goal).length > 0)
      return;
    this.store.change({
      goal: adverbsByName(
        verb,
        opened.adverbs.map((adverb) => round(adverb.goal)),
      ),
    });
  }

  /** A motion that does not loop pauses at its end. */
  private onEnd(): void {
    const { view } = this.store;
    if (this.drive.active) return this.drive.end();
    if (view.playing && !view.loop) this.store.change({ playing: false, phase: view.speed < 0 ? 0 : 1 });
  }

  private onPictures(pictures: Record<Role, Drawn | null>): void {
    const { main, comparison } = pictures;
    const { verb } = this;
    const isShown = (name: string) => name === verb?.name || this.drive.shows(name);
    if (!main || !verb || !isShown(main.shown.verb) || (comparison && comparison.shown.verb !== verb.name)) return;
    this.shown.main = main.shown;
    this.emitter.emit("picture", { role: "main", picture: pictureOf(main) });
    const version = this.version.beside(main.shown, main.poses, verb.looping);
    this.shown.comparison = version?.shown ?? comparison?.shown ?? null;
    const picture = version?.picture ?? (comparison ? pictureOf(comparison) : null);
    this.emitter.emit("picture", { role: "comparison", picture });
    this.emitter.emit("frame", main.shown);
  }

  private comparisonFailed(err: unknown): void {
    this.store.change({ compare: { kind: "none" } });
    this.notify(`Comparison failed: ${textOf(err)}`, "error");
  }
}

function pictureOf({ shown, poses }: Drawn): Picture {
  return { count: shown.count, poses, error: shown.error, phase: shown.phase };
}

/** Round to 0.1 mm, which keeps links readable. */
function round(value: number): number {
  return Number(value.toFixed(DIGITS));
}

export function textOf(err: unknown): string {
  return err instanceof AdverbError ? err.detail : err instanceof Error ? err.message : String(err);
}
