/** View of an open draft: clips with their keytimes at the left, the scene at the right. */

import { AdverbError } from "adverb-client";
import { textOf } from "../app";
import { Disposables } from "../panels/parts/disposables";
import { adverbSlider, type SliderRow } from "../panels/parts/slice_sliders";
import { h } from "../shell/dom";
import type { ThemeController } from "../theme";
import type { App } from "../types";
import { countText } from "../units";
import { ClipRow, LEFT_OUT } from "./clip_row";
import { askDelete, askPublish } from "./dialogs";
import { DraftScene } from "./draft_scene";
import { DraftSession } from "./draft_session";
import { publishDraftState } from "./published";
import { settings } from "./settings";
import type { Draft, DraftEdit } from "./types";

/** Scene width below which the legend covers the figure, and window width from which the goal's sliders are open. */
const NARROW_PX = 600;
const WIDE_PX = 1080;
const NEW_VIEW = { method: "", goal: {}, phase: 0, camera: null, across: "", up: "", slice: null, clip: "", draft: "" };

/** Open the draft of the view in `host`; returns the function that closes it. */
export function mount(host: HTMLElement, app: App, colours: ThemeController): () => void {
  const disposables = new Disposables();
  host.replaceChildren(h("p", { className: "draft-wait", role: "status" }, "Loading the draft…"));
  const open = async () => {
    try {
      const draft = await app.rest.drafts.get(app.store.view.draft);
      if (disposables.disposed) return;
      const view = new DraftView(host, app, colours, draft);
      disposables.add(() => view.dispose());
      await view.start();
    } catch (err) {
      if (!disposables.disposed) host.replaceChildren(failure(app, err));
    }
  };
  void open();
  return () => disposables.dispose();
}

function failure(app: App, err: unknown): HTMLElement {
  const unknown = err instanceof AdverbError && err.code === "unknown_draft";
  const text = unknown ? "This draft does not exist on this server; it may have been deleted." : textOf(err);
  const onclick = () => app.store.change({ draft: "", clip: "", panel: "upload" }, true);
  const back = h("button", { type: "button", onclick }, "Back");
  return h("div", { className: "draft-wait" }, h("p", { className: "failure", role: "alert" }, text), back);
}

class DraftView {
  readonly #session: DraftSession;
  readonly #scene: DraftScene;
  readonly #disposables = new Disposables();
  readonly #rows = new Map<string, ClipRow>();
  readonly #list = h("ul", { className: "clips", "aria-label": "Clips" });
  readonly #title = h("h1", {});
  readonly #count = h("h2", {});
  readonly #error = h("span", { className: "quiet", title: LEFT_OUT });
  readonly #state = h("span", { className: "quiet", role: "status" });
  readonly #problem = h("p", { className: "failure", role: "alert", hidden: true });
  readonly #evidence = h("details", { className: "quiet" });
  readonly #goal = h("details", { className: "draft-goal", open: innerWidth > WIDE_PX });
  readonly #legend = h("p", { className: "draft-legend" });
  readonly #buttons: { propose: HTMLButtonElement; publish: HTMLButtonElement };
  readonly #settings = settings((edit) => this.#edit(edit));
  #sliders: Map<string, SliderRow> = new Map();
  #sliderKey = "";
  #motion = "";
  #editProblem = "";
  #blendProblem = "";

  constructor(
    private readonly host: HTMLElement,
    private readonly app: App,
    colours: ThemeController,
    draft: Draft,
  ) {
    this.#session = new DraftSession(app.rest.drafts, draft);
    const stage = h("div", { className: "stage" });
    const propose = h("button", { type: "button", onclick: () => this.#edit({ propose: true }) }, "Propose again");
    propose.title = "Propose the keytimes of all other clips again, from those that were set by hand";
    const publish = h(
      "button",
      { type: "button", className: "primary", onclick: () => void this.#publish() },
      "Publish…",
    );
    this.#buttons = { propose, publish };
    const remove = h("button", { type: "button", onclick: () => void this.#remove() }, "Delete draft…");
    const close = h("button", { type: "button", onclick: () => this.#close() }, "Close");
    const head = h(
      "div",
      { className: "draft-head" },
      close,
      this.#title,
      this.#state,
      h("div", { className: "grow" }),
      publish,
    );
    const clipsHead = h("div", { className: "clips-head" }, this.#count, this.#error, propose);
    const left = h(
      "section",
      { className: "draft-panel", "aria-label": "Clips and settings", tabIndex: -1 },
      this.#settings.element,
      this.#evidence,
      clipsHead,
      this.#list,
      h("div", { className: "draft-end" }, remove),
    );
    const overlay = h("div", { className: "draft-over" }, this.#legend, this.#goal);
    const right = h("section", { className: "draft-scene", "aria-label": "Scene of the draft" }, stage);
    host.replaceChildren(head, this.#problem, left, right);
    this.#scene = new DraftScene(stage, app.rest.drafts, app.store.view.detail);
    right.append(overlay, this.#scene.player.element);
    this.#listen(colours, right);
  }

  async start(): Promise<void> {
    await this.#loadMotion();
    if (this.#disposables.disposed) return;
    const { draft } = this.#session;
    const known = draft.clips.some(({ name }) => name === this.app.store.view.clip);
    const first = draft.clips.find(({ excluded }) => !excluded) ?? draft.clips[0];
    if (!known) this.app.store.change({ clip: first?.name ?? "" });
    this.#scene.setSaved(draft);
    const measured = draft.verb?.keytime_phases[draft.effector_keytime_index];
    this.#show();
    if (measured !== undefined) this.#scene.player.seek(measured);
    document.documentElement.dataset.ready ??= "true";
  }

  dispose(): void {
    this.#disposables.dispose();
    this.#session.close();
    this.#scene.dispose();
    this.host.replaceChildren();
  }

  #listen(colours: ThemeController, right: HTMLElement): void {
    const { store } = this.app;
    const scene = this.#scene;
    scene.onPhase = () => this.#showTimes();
    scene.onClip = (name) => store.change({ clip: name });
    scene.onGoal = (goal) => {
      for (const [name, row] of this.#sliders) row.show(goal[name] ?? 0);
    };
    scene.onProblem = (problem) => {
      this.#blendProblem = problem;
      this.#showProblem();
    };
    const keys = (event: KeyboardEvent) => this.#key(event);
    document.addEventListener("keydown", keys);
    const sizes = new ResizeObserver(() => {
      const { top, bottom, width } = right.getBoundingClientRect();
      const covered = width < NARROW_PX ? this.#legend.getBoundingClientRect().bottom - top : 0;
      scene.stage.setInset(covered, bottom - scene.player.element.getBoundingClientRect().top);
    });
    sizes.observe(right);
    sizes.observe(scene.player.element);
    this.#disposables.add(
      () => document.removeEventListener("keydown", keys),
      () => sizes.disconnect(),
      colours.on((dark) => scene.setTheme(dark)),
      store.on(["clip"], () => this.#show()),
      this.#session.on("draft", () => this.#show()),
      this.#session.on("saved", (draft) => void this.#saved(draft)),
      this.#session.on("saving", () => this.#showState()),
      this.#session.on("problem", (problem) => {
        this.#editProblem = problem;
        this.#showProblem();
      }),
      publishDraftState(() => ({ draft: this.#session.draft, saving: this.#session.saving, scene })),
    );
  }

  #edit(edit: DraftEdit): void {
    this.#session.edit(edit);
  }

  async #saved(draft: Draft): Promise<void> {
    if (draft.motion !== this.#motion) await this.#loadMotion();
    if (this.#disposables.disposed) return;
    this.#scene.setSaved(draft);
    this.#show();
  }

  async #loadMotion(): Promise<void> {
    const { id, motion } = this.#session.draft;
    const loaded = await this.app.rest.drafts.motion(id);
    if (this.#disposables.disposed) return;
    this.#motion = motion;
    this.#scene.setMotion(loaded);
  }

  #show(): void {
    const { draft } = this.#session;
    const { clip: selected } = this.app.store.view;
    this.#settings.show(draft);
    const used = draft.clips.filter(({ excluded }) => !excluded).length;
    this.#title.textContent = draft.name === "draft" ? "Draft" : `Draft of ${draft.name}`;
    this.#count.textContent = `${countText(draft.clips.length, "clip")}, ${used} used`;
    const mean = draft.left_out_mean;
    this.#error.textContent = mean === null ? "" : `left-out error ${mean.toFixed(1)}° on average`;
    this.#buttons.propose.hidden = !draft.clips.some(({ set }) => set);
    this.#buttons.publish.disabled = draft.verb === null;
    const texts = [...Object.entries(draft.evidence).map(([key, text]) => `${key}: ${text}`), ...draft.warnings];
    this.#evidence.replaceChildren(
      h(
        "summary",
        {},
        draft.warnings.length > 0 ? `Evidence and ${countText(draft.warnings.length, "warning")}` : "Evidence",
      ),
      h("ul", { className: "needs" }, ...texts.map((text) => h("li", {}, text))),
    );
    this.#showRows(draft, selected);
    this.#scene.setClips(draft, selected);
    this.#showGoal(draft);
    this.#legend.replaceChildren(
      h("span", { className: "of-blend" }, "blend"),
      selected && h("span", { className: "of-clip" }, selected),
    );
    this.#showTimes();
    this.#showState();
    this.#showProblem();
  }

  #showRows(draft: Draft, selected: string): void {
    const names = draft.clips.map(({ name }) => name);
    if (names.join("/") !== [...this.#rows.keys()].join("/")) {
      this.#rows.clear();
      for (const name of names) this.#rows.set(name, this.#row(name));
      this.#list.replaceChildren(...[...this.#rows.values()].map(({ element }) => element));
    }
    for (const clip of draft.clips) this.#rows.get(clip.name)?.show(clip, draft, clip.name === selected);
    this.#showCurves(draft);
  }

  #row(name: string): ClipRow {
    return new ClipRow(name, {
      select: (clip) => this.app.store.change({ clip }),
      keytime: (_, k) => {
        const phase = this.#session.draft.verb?.keytime_phases[k];
        if (phase !== undefined) this.#scene.player.seek(phase);
      },
      dragged: (on) => this.#session.hold(on),
      edit: (clip, edit) => this.#edit({ clips: { [clip]: edit } }),
    });
  }

  /** Speed of the effector behind each time line. */
  #showCurves(draft: Draft): void {
    const { figures } = this.#scene;
    const joint = Math.max(draft.joints.indexOf(draft.effector ?? ""), 0);
    const key = `${this.#motion}/${joint}`;
    if (!figures) return;
    for (const [name, { element, line }] of this.#rows) {
      const clip = figures.clips.get(name);
      if (!clip || element.dataset.curve === key) continue;
      element.dataset.curve = key;
      line.showCurve(figures.speeds(clip, joint));
    }
  }

  #showTimes(): void {
    for (const [name, { line }] of this.#rows) line.showTime(this.#scene.timeOf(name));
  }

  #showGoal(draft: Draft): void {
    const key = JSON.stringify(draft.verb?.adverbs ?? null);
    if (key === this.#sliderKey) return;
    this.#sliderKey = key;
    const { goal } = this.#scene;
    const drag = (name: string, value: number) => this.#scene.setGoal({ ...this.#scene.goal, [name]: value });
    const adverbs = draft.verb?.adverbs ?? [];
    this.#sliders = new Map(
      adverbs.map((each) => [each.name, adverbSlider(each, each.name, goal?.[each.name] ?? 0, drag)]),
    );
    this.#goal.hidden = adverbs.length === 0;
    this.#goal.replaceChildren(h("summary", {}, "Goal"), ...[...this.#sliders.values()].map(({ element }) => element));
  }

  #showState(): void {
    this.#state.textContent = this.#session.saving ? "Saving…" : "Saved";
  }

  #showProblem(): void {
    const { problem } = this.#session.draft;
    const text = this.#editProblem || (problem ? `No verb yet: ${problem.detail}` : this.#blendProblem);
    this.#problem.textContent = text;
    this.#problem.hidden = !text;
  }

  #key(event: KeyboardEvent): void {
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("input, select, textarea, dialog")) return;
    const { player, stage } = this.#scene;
    if (event.key === " " && !target.closest("button:not([role=slider]), summary, a")) player.play(!player.playing);
    else if (event.key === "ArrowLeft") player.seek(player.phase - (event.shiftKey ? 0.1 : 0.01));
    else if (event.key === "ArrowRight") player.seek(player.phase + (event.shiftKey ? 0.1 : 0.01));
    else if (event.key === "r") stage.resetView();
    else return;
    event.preventDefault();
  }

  #close(): void {
    this.app.store.change({ draft: "", clip: "" }, true);
  }

  async #publish(): Promise<void> {
    const { app } = this;
    const name = await askPublish(this.host, this.#session.draft.name, app.verbs);
    if (name === null) return;
    this.#buttons.publish.disabled = true;
    this.#state.textContent = "Publishing…";
    try {
      await this.#session.settled();
      const { id } = this.#session.draft;
      const { verb, version } = await app.rest.drafts.publish(id, name);
      await app.reload();
      app.store.change({ ...NEW_VIEW, verb, panel: "verb", drive: false, compare: { kind: "none" } }, true);
      app.notify(`Published ${verb} v${version}`);
    } catch (err) {
      this.#editProblem = textOf(err);
      this.#showProblem();
      this.#showState();
      this.#buttons.publish.disabled = false;
    }
  }

  async #remove(): Promise<void> {
    const { draft } = this.#session;
    if (!(await askDelete(this.host, draft.name))) return;
    try {
      await this.#session.settled();
      await this.app.rest.drafts.remove(draft.id);
      this.app.store.change({ draft: "", clip: "", panel: "upload" }, true);
    } catch (err) {
      this.#editProblem = textOf(err);
      this.#showProblem();
    }
  }
}
