/** The figure of the user's file: loaded, mapped to the displayed verb, posed with every picture. */

import type { Page } from "../app";
import { textOf } from "../app";
import type { Picture, Replacement, Stage } from "../types";
import { forget, keep, kept } from "./kept";
import { FIGURE_FILE, loadModel } from "./load";
import type { Model } from "./model";

export class OwnFigure {
  model: Model | null = null;
  /** Corrections of the mapping: joints of the figure by joints of the verb. */
  joints: Record<string, string> = {};
  /** Whether the browser keeps the figure and its corrections as they are. */
  isKept = false;
  /** Called when the figure, its mapping, or the verb changed. */
  onChange = () => {};
  private file: Blob | null = null;
  private loading = "";
  private stage: Stage | null = null;
  /** The last pose, which a paused motion keeps, and its phase. */
  private last: { values: Float32Array; phase: number | null } | null = null;

  constructor(private readonly page: Page) {
    page.store.on(["figure"], () => void this.restore());
    page.store.on(["figureGoal"], () => this.bind());
    page.on("verb", () => this.bind());
    page.on("picture", ({ role, picture }) => role === "main" && this.show(picture));
  }

  /** Show in a scene, and read the figure that the link names. */
  start(stage: Stage | null): void {
    this.stage = stage;
    void this.restore();
  }

  /** Whether a file may be a figure. */
  static accepts(file: File | undefined): file is File {
    return file !== undefined && FIGURE_FILE.test(file.name);
  }

  /** Show a file, and keep it in this browser. */
  async take(file: File): Promise<void> {
    try {
      const model = await loadModel(file);
      this.loading = file.name;
      this.joints = {};
      this.page.store.change({ figure: file.name });
      this.replace(model, file);
      await this.save();
    } catch (err) {
      this.page.notify(textOf(err), "error");
    }
  }

  /** Answer a dropped file that is no figure. */
  refuse(): void {
    this.page.notify("Drop a GLB or VRM file of a figure here. Clips and verbs belong to the Upload tab.", "error");
  }

  remove(): void {
    const { figure } = this.page.store.view;
    this.page.store.change({ figure: "" });
    void forget(figure).catch(() => {});
  }

  /** Move a joint of the figure by a joint of the verb; an empty one is left out. */
  correct(source: string, target: string): void {
    this.joints = { ...this.joints, [source]: target };
    this.bind();
    void this.save();
  }

  /** Drop all corrections. */
  reset(): void {
    this.joints = {};
    this.bind();
    void this.save();
  }

  private async save(): Promise<void> {
    const { file, loading: name, joints } = this;
    if (!file) return;
    this.isKept = false;
    try {
      await keep({ name, file, joints });
      this.isKept = this.joints === joints;
    } catch {
      this.page.notify("This browser does not keep the figure; drop it again after a reload.");
    }
  }

  private async restore(): Promise<void> {
    const { figure } = this.page.store.view;
    if (figure === this.loading) return;
    this.loading = figure;
    this.replace(null, null);
    if (!figure) return;
    try {
      const found = await kept(figure);
      if (this.loading !== figure) return;
      if (!found) {
        this.page.notify(`The figure ${figure} is not kept in this browser. Drop its file to show it.`);
        return this.page.store.change({ figure: "" });
      }
      const model = await loadModel(found.file);
      if (this.loading !== figure) return model.dispose();
      this.joints = found.joints;
      this.isKept = true;
      this.replace(model, found.file);
    } catch (err) {
      this.page.notify(textOf(err), "error");
      this.page.store.change({ figure: "" });
    }
  }

  private replace(model: Model | null, file: Blob | null): void {
    this.model?.dispose();
    this.model = model;
    this.file = file;
    this.bind();
  }

  private bind(): void {
    const { model, stage } = this;
    const { verb, store } = this.page;
    if (model && verb) {
      try {
        model.bind(verb, { joints: this.joints, goal: store.view.figureGoal });
      } catch (err) {
        this.page.notify(`${textOf(err)} The verb ${verb.name} keeps its own figure.`);
      }
    }
    if (model?.mapper) stage?.add(model.object);
    else model?.object.removeFromParent();
    this.pose();
    stage?.setReplaced(this.replacement());
    this.onChange();
  }

  private replacement(): Replacement | null {
    const { mapper } = this.model ?? {};
    if (!mapper) return null;
    const goal = this.page.store.view.figureGoal === "scaled" ? mapper.scale : 1;
    return { travel: mapper.scale, goal, effector: () => mapper.effectorPosition() };
  }

  private show(picture: Picture | null): void {
    const { page } = this;
    const size = 3 + 4 * (page.verb?.skeleton.names.length ?? 0);
    if (!picture || picture.count === 0 || picture.poses.length < picture.count * size) return; // another skeleton
    const isOwn = page.shown.main?.verb === page.verb?.name;
    this.last = { values: picture.poses.slice(0, size), phase: isOwn ? picture.phase : null };
    this.pose();
  }

  private pose(): void {
    const { model, last, page, stage } = this;
    if (!model?.mapper || !last || last.values.length !== 3 + 4 * (page.verb?.skeleton.names.length ?? 0)) return;
    model.pose(last.values, last.phase);
    stage?.requestDraw();
  }
}
