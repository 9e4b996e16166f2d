/** The draft's scene: paths and ghosts of the clips, the selected clip, and the blend at a goal. */

import { createStage } from "../scene/stage";
import type { Picture, Stage, Verb } from "../types";
import { Blend } from "./blend";
import { ClipLayer } from "./clip_layer";
import { ClipTime } from "./clip_time";
import { ClipFigures, type ShownClip } from "./figures";
import { Player } from "./player";
import { centralGoal, phasesOf, sceneVerb } from "./scene_verb";
import type { Draft, DraftMotion, DraftRest } from "./types";

export class DraftScene {
  readonly player = new Player();
  readonly stage: Stage;
  /** The goal was dragged, or a new verb has another default. */
  onGoal: (goal: Readonly<Record<string, number>>) => void = () => {};
  /** A mark of a clip was clicked. */
  onClip: (name: string) => void = () => {};
  /** The displayed phase changed. */
  onPhase: () => void = () => {};
  onProblem: (problem: string) => void = () => {};
  goal: Readonly<Record<string, number>> | null = null;
  /** Revisions whose blend is shown; for tests. */
  blendRevision = 0;
  readonly #blend: Blend;
  #figures: ClipFigures | null = null;
  #motion: DraftMotion | null = null;
  #layer: ClipLayer | null = null;
  #draft: Draft | null = null;
  #selected = "";
  #clips: ShownClip[] = [];
  #stageKey = "";
  #verbKey = "";

  constructor(host: HTMLElement, rest: DraftRest, detail: "high" | "low") {
    this.stage = createStage(host, detail);
    this.stage.setMarks({ hull: true, examples: true, pseudo: false });
    this.#blend = new Blend(rest);
    this.#blend.onChange = (problem, revision) => {
      this.blendRevision = revision;
      this.onProblem(problem);
      this.#showFigures();
    };
    this.stage.onGoal = (goal) => this.setGoal(goal);
    this.stage.onExample = (adverbs) => {
      const name = this.#draft?.verb?.examples.find((one) => one.adverbs === adverbs)?.name;
      if (name) this.onClip(name);
    };
    this.player.onChange = () => {
      this.onPhase();
      this.#showFigures();
    };
  }

  get figures(): ClipFigures | null {
    return this.#figures;
  }

  setMotion(motion: DraftMotion): void {
    this.#motion = motion;
    this.#figures = new ClipFigures(motion);
    this.#stageKey = "";
  }

  /** A saved draft: its verb gives hull and blend. */
  setSaved(draft: Draft): void {
    const motion = this.#motion;
    if (!motion) return;
    const key = JSON.stringify([draft.motion, draft.effector, draft.measure, draft.keytime_names.length]);
    const verbKey = JSON.stringify([draft.verb?.examples, draft.verb?.adverbs, draft.effector_keytime_index]);
    const verb = sceneVerb(draft, motion);
    if (key !== this.#stageKey) {
      this.stage.setVerb(verb);
      this.#makeLayer(draft, verb, motion);
    } else if (verbKey !== this.#verbKey) this.stage.updateVerb(verb);
    [this.#stageKey, this.#verbKey] = [key, verbKey];
    this.player.setKeytimes(draft.keytime_names, phasesOf(draft), draft.effector_keytime_index);
    this.player.durationS = draft.verb ? (draft.verb.duration.min + draft.verb.duration.max) / 2 : 2;
    if (!this.goal || !draft.verb?.adverbs.every(({ name }) => name in (this.goal ?? {}))) {
      this.goal = draft.verb ? centralGoal(draft.verb) : null;
    }
    this.#draft = draft;
    if (this.goal) {
      this.stage.setGoal(this.goal);
      this.onGoal(this.goal);
    }
    this.#blend.request(draft, this.goal ?? {});
  }

  /** The displayed draft, with edits that are not saved yet. */
  setClips(draft: Draft, selected: string): void {
    this.#selected = selected;
    const phases = phasesOf(draft);
    this.#clips = draft.clips.flatMap(({ name, keytimes, excluded }) => {
      if (!keytimes || keytimes.length !== phases.length || keytimes.length < 2) return [];
      const time = new ClipTime(phases, keytimes, draft.looping);
      return [{ name, keytimes, excluded, time, selected: name === selected }];
    });
    this.#layer?.showPaths(this.#clips, draft.effector_keytime_index);
    this.#showFigures();
  }

  setGoal(goal: Readonly<Record<string, number>>): void {
    this.goal = goal;
    this.stage.setGoal(goal);
    this.onGoal(goal);
    if (this.#draft) this.#blend.request(this.#draft, goal);
  }

  setTheme(dark: boolean): void {
    this.stage.setTheme(dark);
    this.#layer?.setPalette(this.stage.palette);
    if (this.#draft) this.#layer?.showPaths(this.#clips, this.#draft.effector_keytime_index);
    this.stage.requestDraw();
  }

  /** Seconds of a clip at the displayed phase; null if it is not shown. */
  timeOf(name: string): number | null {
    return this.#clips.find((clip) => clip.name === name)?.time.at(this.player.phase) ?? null;
  }

  dispose(): void {
    this.player.dispose();
    this.#layer?.dispose();
    this.stage.dispose();
  }

  #makeLayer(draft: Draft, verb: Verb, motion: DraftMotion): void {
    if (!this.#figures) return;
    this.#layer?.dispose();
    const effector = Math.max(verb.skeleton.names.indexOf(draft.effector ?? ""), 0);
    const most = { clips: motion.clips.length, keytimes: Math.max(draft.keytime_names.length, 2) };
    this.#layer = new ClipLayer(this.#figures, verb.skeleton, effector, most);
    this.#layer.setPalette(this.stage.palette);
    this.stage.add(this.#layer.group);
    this.stage.setExtent(extentOf(this.#figures, draft, effector));
  }

  #showFigures(): void {
    const { phase, shown } = this.player;
    this.#layer?.setVisible(shown.paths);
    this.#layer?.showGhosts(this.#clips, phase, shown.ghosts);
    const blend = shown.blend ? this.#blend.at(phase) : null;
    const clip = this.#clips.find(({ name }) => name === this.#selected);
    const motion = clip ? this.#figures?.clips.get(clip.name) : undefined;
    const own = clip && motion && this.#figures ? this.#figures.pose(motion, clip.time.at(phase)) : null;
    const picture = (poses: Float32Array, error = Number.NaN): Picture => ({ count: 1, poses, error, phase });
    this.stage.show("main", blend ? picture(blend.poses, blend.error) : own ? picture(own) : null);
    this.stage.show("comparison", blend && own ? picture(own) : null);
    this.stage.requestDraw();
  }
}

/** Some positions of the effector in every clip, for the camera. */
function extentOf(figures: ClipFigures, draft: Draft, effector: number): (readonly [number, number, number])[] {
  return draft.clips.flatMap(({ name, excluded }) => {
    const clip = figures.clips.get(name);
    if (!clip || excluded) return [];
    return [0, 0.25, 0.5, 0.75, 1].map((share) => {
      const [x = 0, y = 0, z = 0] = figures.point(clip, effector, clip.start + share * (clip.end - clip.start));
      return [x, y, z] as const;
    });
  });
}
