import { heading, poseLength } from "adverb-client";
import { Group, type Object3D, Scene, Vector3, type WebGLRenderer } from "three";
import type { CrowdPlaces, Drawn, Incline, Picture, Replacement, Role, Stage, Verb } from "../types";
import { anatomyOf } from "./anatomy";
import { CameraRig } from "./camera";
import { CrowdDetail } from "./crowd_detail";
import { Feet } from "./feet";
import { NOTHING_DRAWN } from "./figure_rect";
import { Figures } from "./figures";
import { GoalHandle } from "./goal";
import { GoalFrame } from "./goal_frame";
import { type Adverbs, clampGoal, type ExamplePoint, type GoalSpace, goalSpaceOf } from "./goal_space";
import { Ground } from "./ground";
import { type Layout, layoutOf } from "./layout";
import { Lights } from "./light";
import { Marks } from "./marks";
import { materials } from "./materials";
import { Overlays } from "./overlays";
import { type Palette, paletteOf } from "./palette";
import { Pointer } from "./pointer";
import { rendererOf } from "./renderer";
import { SlopedGround } from "./slope";
import type { V3 } from "./vec";

const NOWHERE: CrowdPlaces = { count: 0, places: new Float32Array(0), distant: null };
/** Distance from the camera within which a crowd is hidden, and extent of the grid, in drive mode, m. */
const CLEARANCE_M = 4;
const DRIVEN_REACH_M = 24;

export function createStage(host: HTMLElement, detail: "high" | "low"): Stage {
  return new WebGLStage(host, rendererOf(detail));
}

class WebGLStage implements Stage {
  onGoal: Stage["onGoal"] = () => {};
  onExample: Stage["onExample"] = () => {};
  onCamera: Stage["onCamera"] = () => {};
  onOffscreen: Stage["onOffscreen"] = () => {};
  readonly drawn: Drawn = { ...NOTHING_DRAWN };

  readonly #host: HTMLElement;
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #rig: CameraRig;
  readonly #ground = new Ground();
  readonly #lights = new Lights();
  readonly #goal = new GoalHandle();
  readonly #pointer: Pointer;
  readonly #resized: ResizeObserver;
  readonly #overlays: Overlays;
  /** Origin of the goal space. */
  readonly #frame = new Group();
  readonly #goalFrame = new GoalFrame();
  readonly #materials = materials();

  #verb: Verb | null = null;
  #space: GoalSpace | null = null;
  #marks: Marks | null = null;
  #figures: Record<Role, Figures> | null = null;
  #feet: Feet | null = null;
  #layout: Layout | null = null;
  readonly #slope = new SlopedGround();
  #adverbs: Adverbs = {};
  #shownMarks = { hull: true, examples: true, pseudo: true };
  #detail: "high" | "low" = "high";
  readonly #crowdDetail = new CrowdDetail();
  #dark = false;
  #following = false;
  #driving = false;
  #other: Replacement | null = null;
  #request = 0;
  #drawnAt = 0;

  constructor(host: HTMLElement, renderer: WebGLRenderer) {
    this.#host = host;
    if (getComputedStyle(host).position === "static") host.style.position = "relative";
    this.#renderer = renderer;
    const surface = renderer.domElement;
    host.append(surface);
    this.#pointer = new Pointer(surface, this.#context(), this.#actions());
    this.#rig = new CameraRig(surface, () => this.requestDraw());
    this.#rig.onCamera = (camera) => this.#driving || this.onCamera(camera);
    this.#overlays = new Overlays(host, { ground: this.#ground, lights: this.#lights, goal: this.#goal });
    this.#frame.add(this.#goal.group);
    this.#scene.add(this.#ground.group, this.#lights.group, this.#frame, this.#goal.effectorGroup);
    this.#resized = new ResizeObserver(() => this.#resize());
    this.#resized.observe(host);
    surface.addEventListener("webglcontextrestored", () => this.requestDraw());
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
    this.#resize();
  }

  setVerb(verb: Verb): void {
    this.#clear();
    const marks = this.#describe(verb);
    const anatomy = anatomyOf(verb.skeleton);
    this.#layout = layoutOf(anatomy, verb, marks.points);
    this.#feet = new Feet(anatomy);
    const { rows } = this.#layout;
    const { main, prepass, other } = this.#materials;
    this.#figures = {
      main: new Figures(verb.skeleton, [main], rows, this.#crowdDetail.shapes(this.#detail)),
      comparison: new Figures(verb.skeleton, [prepass, other], rows, this.#crowdDetail.shapes(this.#detail)),
    };
    this.setReplaced(this.#other);
    this.#scene.add(this.#figures.main.group, this.#figures.comparison.group, this.#feet.mesh);
    this.#rig.setFrame(this.#layout.frame(1));
    this.#arrange();
    this.setTheme(this.#dark);
  }

  updateVerb(verb: Verb): void {
    this.#describe(verb).setPalette(this.palette);
    this.#arrange();
    this.requestDraw();
  }

  setExtent(points: readonly V3[]): void {
    if (!this.#verb || !this.#marks) return;
    this.#layout = layoutOf(anatomyOf(this.#verb.skeleton), this.#verb, this.#marks.points, points);
    this.#rig.setFrame(this.#layout.frame(this.#figures?.main.count ?? 1));
    this.requestDraw();
  }

  setIncline(incline: Incline | null): void {
    this.#slope.set(incline);
    this.requestDraw();
  }

  show(role: Role, picture: Picture | null): void {
    const figures = this.#figures?.[role];
    if (!figures || !this.#layout) return;
    // Ignore a stale picture of another skeleton.
    if (picture && picture.poses.length < picture.count * poseLength(figures.rig.joints)) return;
    const before = figures.count;
    figures.show(picture, this.#rig.camera.position.toArray());
    if (role === "main" && picture && picture.count > 0) {
      this.#overlays.phase = picture.phase;
      const now_s = performance.now() / 1000;
      this.#slope.follow(picture.phase, figures.positions, heading(figures.rotations, 0), now_s);
      if (!this.#layout.wall) this.#feet?.update(figures.positions, now_s, this.#slope);
      if (this.#space?.kind === "jump") this.#goalFrame.updateJump(picture.phase, figures.positions, figures.rotations);
      if (before !== picture.count) {
        this.#rig.setFrame(this.#layout.frame(picture.count));
        this.#arrange();
      }
    }
    this.requestDraw();
  }

  setGoal(goal: Adverbs): void {
    if (this.#pointer.dragging) return;
    this.#showGoal(goal);
  }

  setMarks(marks: { hull: boolean; examples: boolean; pseudo: boolean }): void {
    this.#shownMarks = { ...marks };
    this.#marks?.show(marks);
    this.requestDraw();
  }

  setFollow(follow: boolean): void {
    this.#following = follow;
    this.#rig.follow(null, 0);
    this.requestDraw();
  }

  setDrive(drive: boolean): void {
    if (drive === this.#driving) return;
    this.#driving = drive;
    this.#arrange();
    this.setCamera(null);
  }

  setDetail(detail: "high" | "low"): void {
    this.#detail = detail;
    this.#applyDetail();
  }

  setTheme(dark: boolean): void {
    this.#dark = dark;
    const palette = paletteOf(this.#host, dark);
    this.#materials.main.color.copy(palette.figure);
    this.#materials.other.color.copy(palette.other);
    this.#marks?.setPalette(palette);
    this.#feet?.setPalette(palette);
    for (const part of [this.#ground, this.#lights, this.#goal]) part.setPalette(palette);
    this.requestDraw();
  }

  setCamera(camera: readonly number[] | null): void {
    if (this.#driving) this.#rig.chase(this.#origin(), this.#goalFrame.heading);
    else if (camera) this.#rig.set(camera);
    else this.#rig.reset(this.#origin());
    this.requestDraw();
  }

  setInset(top: number, bottom: number): void {
    this.#rig.setInset(top, bottom);
    this.requestDraw();
  }

  resetView(): void {
    this.setCamera(null);
  }

  setReplaced(other: Replacement | null): void {
    this.#other = other;
    if (this.#figures) this.#figures.main.replaced = other !== null;
    if (this.#feet) this.#feet.mesh.visible = other === null;
    this.#frame.scale.setScalar(other?.goal ?? 1);
    this.requestDraw();
  }

  add(objects: Object3D): void {
    this.#scene.add(objects);
  }

  get palette(): Palette {
    return paletteOf(this.#host, this.#dark);
  }

  dispose(): void {
    cancelAnimationFrame(this.#request);
    this.#request = -1;
    this.#resized.disconnect();
    this.#clear();
    for (const part of [this.#crowdDetail, this.#pointer, this.#rig]) part.dispose();
    for (const part of [this.#ground, this.#lights, this.#goal, this.#overlays]) part.dispose();
    for (const material of Object.values(this.#materials)) material.dispose();
    this.#renderer.dispose();
    this.#renderer.domElement.remove();
  }

  #context() {
    const stage = this;
    return {
      get camera() {
        return stage.#rig.camera;
      },
      get marks() {
        return stage.#driving ? null : stage.#marks;
      },
      get space() {
        return stage.#space;
      },
      goal: this.#goal,
      frame: this.#frame,
    };
  }

  #actions() {
    return {
      grabbed: (grabbed: boolean) => {
        this.#rig.controls.enabled = !grabbed;
        this.#goal.setGrabbed(grabbed ? "grabbed" : "near");
        this.requestDraw();
      },
      dragged: (point: V3, done: boolean) => {
        if (!this.#verb || !this.#space) return;
        const adverbs = clampGoal(this.#verb, this.#space.adverbs(point, this.#adverbs));
        this.#showGoal(adverbs);
        this.onGoal(adverbs, done);
      },
      hovered: (mark: { known: ExamplePoint; at: Vector3 } | null) => {
        if (mark?.known === this.#overlays.hovered?.known) return;
        this.#overlays.hovered = mark;
        this.requestDraw();
      },
      clicked: (known: ExamplePoint) => this.onExample(known.adverbs),
    };
  }

  #showGoal(adverbs: Adverbs): void {
    this.#adverbs = { ...adverbs };
    this.#goal.put(adverbs, this.#verb?.measure.adverbs ?? []);
    this.requestDraw();
  }

  get crowd(): CrowdPlaces {
    return this.#figures?.main ?? NOWHERE;
  }

  #applyDetail(): void {
    const { level } = this.#crowdDetail;
    this.drawn.detail = level;
    this.#lights.setShadows(this.#crowdDetail.hasShadows(this.#detail));
    for (const figures of Object.values(this.#figures ?? {})) figures.setDetail(this.#crowdDetail.shapes(this.#detail));
    this.#resize();
  }

  /** Show goal and marks or, in drive mode, more ground. */
  #arrange(): void {
    if (!this.#layout || !this.#marks) return;
    const reach = this.#layout.reach(this.#figures?.main.count ?? 1);
    this.#ground.lay(this.#layout.wall, this.#layout.back, this.#driving ? Math.max(reach, DRIVEN_REACH_M) : reach);
    if (this.#figures) this.#figures.main.clearance = this.#driving ? CLEARANCE_M : 0;
    this.#marks.group.visible = this.#ground.bar.visible = !this.#driving;
    this.#goal.setSpace(this.#driving ? null : this.#space);
    if (!this.#driving) this.#showGoal(this.#adverbs);
  }

  /** Goal space, marks and measure of a verb; replaces earlier marks. */
  #describe(verb: Verb): Marks {
    const earlier = this.#marks;
    this.#overlays.describe(verb);
    this.#verb = verb;
    this.#space = goalSpaceOf(verb);
    this.#marks = new Marks(verb, this.#space);
    this.#marks.show(this.#shownMarks);
    this.#frame.add(this.#marks.group);
    if (earlier) this.#frame.remove(earlier.group);
    earlier?.dispose();
    return this.#marks;
  }

  #clear(): void {
    for (const role of Object.values(this.#figures ?? {})) {
      this.#scene.remove(role.group);
      role.dispose();
    }
    if (this.#marks) this.#frame.remove(this.#marks.group);
    if (this.#feet) this.#scene.remove(this.#feet.mesh);
    this.#marks?.dispose();
    this.#feet?.dispose();
    [this.#figures, this.#marks, this.#feet, this.#overlays.hovered] = [null, null, null, null];
    this.#slope.set(null);
    this.#goalFrame.reset();
    this.#rig.follow(null, 0);
  }

  #resize(): void {
    const { clientWidth, clientHeight } = this.#host;
    if (!clientWidth || !clientHeight) return;
    this.#renderer.setPixelRatio(this.#crowdDetail.pixelRatio(this.#detail));
    this.#renderer.setSize(clientWidth, clientHeight, false);
    this.#rig.resize(clientWidth, clientHeight);
    this.requestDraw();
  }

  /** Position of a character that travels; the origin for others. */
  #origin(): Vector3 {
    const main = this.#figures?.main;
    return this.#space?.movesWithCharacter && main?.count
      ? new Vector3().fromArray(main.positions).setY(0)
      : new Vector3();
  }

  /** Request one animation frame. */
  requestDraw(): void {
    if (!this.#request) this.#request = requestAnimationFrame((now) => this.#draw(now));
  }

  #draw(now: number): void {
    this.#request = 0;
    const delta_s = Math.min((now - this.#drawnAt) / 1000, 0.1);
    const main = this.#figures?.main;
    if (main && this.#crowdDetail.adapt(main, this.#rig.camera.position, now)) this.#applyDetail();
    this.#drawnAt = now;
    const moving = this.#moveFrames(delta_s);
    if (this.#rig.controls.update(delta_s) || moving) this.requestDraw();
    this.#updateOverlays(main ?? null);
    this.#renderer.render(this.#scene, this.#rig.camera);
    this.drawn.frames += 1;
    this.drawn.goal = this.#goal.shown ? this.#goal.world.toArray() : null;
    this.drawn.contacts = this.#feet?.contacts ?? 0;
    this.drawn.slide = this.#feet?.slide ?? null;
    this.drawn.handle = this.#goal.shown ? this.#pointer.inWindow(this.#goal.world) : null;
  }

  #updateOverlays(main: Figures | null): void {
    const { offscreen: before } = this.#overlays;
    const [rig, layout, slope, other] = [this.#rig, this.#layout, this.#slope, this.#other];
    const modes = { driving: this.#driving, following: this.#following, dragging: this.#pointer.dragging };
    const offscreen = this.#overlays.update({ rig, layout, main, slope, other, ...modes }, this.drawn);
    if (offscreen !== before) this.onOffscreen(offscreen);
  }

  /** Move the goal frame and the camera with the character; returns whether they are still moving. */
  #moveFrames(delta_s: number): boolean {
    const main = this.#figures?.main;
    let moving = false;
    if (main?.count) {
      if (this.#space?.kind === "velocity" && !this.#pointer.dragging) {
        moving = this.#goalFrame.updateStride(main.positions, main.rotations, delta_s);
      }
      const travel = this.#other?.travel ?? 1;
      const [x, , z] = main.positions as unknown as [number, number, number];
      const root = new Vector3(travel * x, travel * this.#slope.height(x, z), travel * z);
      if (this.#rig.follow(this.#following || this.#driving ? root : null, delta_s)) moving = true;
      if (this.#driving && this.#rig.turn(this.#goalFrame.heading)) moving = true;
    }
    const { x, z } = this.#goalFrame;
    this.#frame.position.set(x, this.#slope.height(x, z), z).multiplyScalar(this.#other?.travel ?? 1);
    this.#frame.rotation.y = this.#goalFrame.heading;
    this.#frame.updateMatrixWorld(true);
    return moving;
  }
}
