import { Group, NeutralToneMapping, PCFShadowMap, Scene, Vector3, WebGLRenderer } from "three";
import type { Drawn, Picture, Side, Stage, Verb } from "../types";
import { anatomyOf } from "./anatomy";
import { Eye } from "./camera";
import { Figures } from "./figures";
import { poseLength } from "./fk";
import { GoalHandle } from "./goal";
import { Carried } from "./goal_frame";
import { type Adverbs, bounded, type Known, type Place, placeOf } from "./goal_space";
import { Ground } from "./ground";
import { Label } from "./labels";
import { type Layout, layoutOf } from "./layout";
import { Lights } from "./light";
import { Marks } from "./marks";
import { materials } from "./materials";
import { paletteOf } from "./palette";
import { Pointer } from "./pointer";
import type { V3 } from "./vec";

/** The browser draws no three-dimensional pictures. */
export class NoWebGL extends Error {
  override readonly name = "NoWebGL";
  constructor() {
    super(
      "This browser shows no 3D pictures (WebGL 2 is off or missing). " +
        "Turn on hardware acceleration, or try another browser.",
    );
  }
}

/** How near to the effector's keytime a pose is judged by its distance from the goal, phase. */
const AT_KEYTIME = 0.012;

/** A distance for reading. */
export function distance(metres: number): string {
  if (metres >= 0.1) return `${(metres * 100).toFixed(1)} cm`;
  return `${(metres * 1000).toFixed(metres < 0.01 ? 1 : 0)} mm`;
}

export function createStage(host: HTMLElement): Stage {
  const surface = document.createElement("canvas");
  const context = surface.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "high-performance" });
  if (!context) throw new NoWebGL();
  return new Picturing(host, surface, context);
}

class Picturing implements Stage {
  onGoal: Stage["onGoal"] = () => {};
  onExample: Stage["onExample"] = () => {};
  onCamera: Stage["onCamera"] = () => {};
  readonly drawn: Drawn = { frames: 0, effector: null, goal: null, handle: null };

  readonly #host: HTMLElement;
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #eye: Eye;
  readonly #ground = new Ground();
  readonly #lights = new Lights();
  readonly #goal = new GoalHandle();
  readonly #pointer: Pointer;
  readonly #resized: ResizeObserver;
  readonly #missLabel: Label;
  readonly #markLabel: Label;
  readonly #barLabel: Label;
  /** Stands where the verb's places are counted from. */
  readonly #frame = new Group();
  readonly #carried = new Carried();
  readonly #materials = materials();

  #verb: Verb | null = null;
  #place: Place | null = null;
  #marks: Marks | null = null;
  #figures: Record<Side, Figures> | null = null;
  #layout: Layout | null = null;
  #adverbs: Adverbs = {};
  #shownMarks = { hull: true, examples: true, pseudo: true };
  #detail: "high" | "low" = "high";
  #dark = false;
  #following = false;
  #effector = -1;
  #keytime = Number.NaN;
  #phase = 0;
  #hovered: { known: Known; at: Vector3 } | null = null;
  #request = 0;
  #drawnAt = 0;

  constructor(host: HTMLElement, surface: HTMLCanvasElement, context: WebGL2RenderingContext) {
    this.#host = host;
    if (getComputedStyle(host).position === "static") host.style.position = "relative";
    Object.assign(surface.style, { display: "block", width: "100%", height: "100%", outlineOffset: "-2px" });
    surface.setAttribute("role", "img");
    surface.setAttribute("aria-label", "The character in motion, with its goal");
    host.append(surface);
    this.#renderer = new WebGLRenderer({ canvas: surface, context });
    this.#renderer.shadowMap.enabled = true;
    this.#renderer.shadowMap.type = PCFShadowMap;
    this.#renderer.toneMapping = NeutralToneMapping;
    this.#renderer.setClearAlpha(0);
    this.#pointer = new Pointer(surface, this.#target(), this.#deeds());
    this.#eye = new Eye(surface, () => this.#ask());
    this.#eye.onCamera = (camera) => this.onCamera(camera);
    this.#missLabel = new Label(host, "chip");
    this.#markLabel = new Label(host, "chip");
    this.#barLabel = new Label(host, "plain");
    this.#frame.add(this.#goal.group);
    this.#scene.add(this.#ground.group, this.#lights.group, this.#frame, this.#goal.reached);
    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    surface.addEventListener("webglcontextrestored", () => this.#ask());
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
    this.#fit();
  }

  setVerb(verb: Verb): void {
    this.#clear();
    this.#verb = verb;
    this.#place = placeOf(verb);
    this.#marks = new Marks(verb, this.#place);
    this.#marks.show(this.#shownMarks);
    this.#layout = layoutOf(anatomyOf(verb.skeleton), verb, this.#marks.points);
    const { rows } = this.#layout;
    const { main, prepass, other } = this.#materials;
    this.#figures = {
      main: new Figures(verb.skeleton, [main], rows, this.#detail),
      other: new Figures(verb.skeleton, [prepass, other], rows, this.#detail),
    };
    this.#scene.add(this.#figures.main.group, this.#figures.other.group);
    this.#frame.add(this.#marks.group);
    this.#goal.setPlace(this.#place);
    this.#effector = verb.measure.effector ? verb.skeleton.names.indexOf(verb.measure.effector) : -1;
    this.#keytime = verb.keytime_phases[verb.keytime_names.indexOf(verb.measure.keytime ?? "")] ?? Number.NaN;
    this.#ground.lay(this.#layout.wall, this.#layout.back, this.#layout.reach(1));
    this.#eye.setFrame(this.#layout.frame(1));
    this.setTheme(this.#dark);
  }

  show(side: Side, picture: Picture | null): void {
    const figures = this.#figures?.[side];
    if (!figures || !this.#layout) return;
    if (picture && picture.poses.length < picture.count * poseLength(figures.rig)) return; // of another skeleton
    const before = figures.count;
    figures.show(picture);
    if (side === "main" && picture && picture.count > 0) {
      this.#phase = picture.phase;
      if (this.#place?.kind === "jump") this.#carried.jumps(picture.phase, figures.places, figures.turns);
      if (before !== picture.count) this.#crowd(picture.count);
    }
    this.#ask();
  }

  setGoal(goal: Adverbs): void {
    if (this.#pointer.dragging) return;
    this.#aim(goal);
  }

  setMarks(marks: { hull: boolean; examples: boolean; pseudo: boolean }): void {
    this.#shownMarks = { ...marks };
    this.#marks?.show(marks);
    this.#ask();
  }

  setFollow(follow: boolean): void {
    this.#following = follow;
    this.#eye.follow(null, 0);
    this.#ask();
  }

  setDetail(detail: "high" | "low"): void {
    this.#detail = detail;
    this.#lights.setShadows(detail === "high");
    this.#figures?.main.setDetail(detail);
    this.#figures?.other.setDetail(detail);
    this.#fit();
  }

  setTheme(dark: boolean): void {
    this.#dark = dark;
    const palette = paletteOf(this.#host, dark);
    this.#materials.main.color.copy(palette.figure);
    this.#materials.other.color.copy(palette.other);
    this.#marks?.setPalette(palette);
    for (const part of [this.#ground, this.#lights, this.#goal]) part.setPalette(palette);
    this.#ask();
  }

  setCamera(camera: readonly number[] | null): void {
    if (camera) this.#eye.set(camera);
    else this.#eye.reset(this.#home());
    this.#ask();
  }

  setAside(right: number, bottom: number): void {
    this.#eye.setAside(right, bottom);
    this.#ask();
  }

  resetView(): void {
    this.setCamera(null);
  }

  dispose(): void {
    cancelAnimationFrame(this.#request);
    this.#request = -1;
    this.#resized.disconnect();
    this.#pointer.dispose();
    this.#eye.dispose();
    this.#clear();
    for (const part of [this.#ground, this.#lights, this.#goal]) part.dispose();
    for (const label of [this.#missLabel, this.#markLabel, this.#barLabel]) label.dispose();
    for (const material of Object.values(this.#materials)) material.dispose();
    this.#renderer.dispose();
    this.#renderer.domElement.remove();
  }

  #target() {
    const stage = this;
    return {
      get camera() {
        return stage.#eye.camera;
      },
      get marks() {
        return stage.#marks;
      },
      get place() {
        return stage.#place;
      },
      goal: this.#goal,
      frame: this.#frame,
    };
  }

  #deeds() {
    return {
      held: (held: boolean) => {
        this.#eye.controls.enabled = !held;
        this.#goal.setHeld(held ? "held" : "near");
        this.#ask();
      },
      moved: (point: V3, done: boolean) => {
        if (!this.#verb || !this.#place) return;
        const adverbs = bounded(this.#verb, this.#place.adverbs(point, this.#adverbs));
        this.#aim(adverbs);
        this.onGoal(adverbs, done);
      },
      hovered: (mark: { known: Known; at: Vector3 } | null) => {
        if (mark?.known === this.#hovered?.known) return;
        this.#hovered = mark;
        this.#ask();
      },
      chosen: (known: Known) => this.onExample(known.adverbs),
    };
  }

  #aim(adverbs: Adverbs): void {
    this.#adverbs = { ...adverbs };
    this.#goal.put(adverbs, this.#verb?.measure.adverbs ?? []);
    this.#ask();
  }

  #crowd(count: number): void {
    if (!this.#layout) return;
    this.#ground.lay(this.#layout.wall, this.#layout.back, this.#layout.reach(count));
    this.#eye.setFrame(this.#layout.frame(count));
  }

  #clear(): void {
    for (const side of Object.values(this.#figures ?? {})) {
      this.#scene.remove(side.group);
      side.dispose();
    }
    if (this.#marks) this.#frame.remove(this.#marks.group);
    this.#marks?.dispose();
    [this.#figures, this.#marks, this.#hovered] = [null, null, null];
    this.#carried.reset();
    this.#eye.follow(null, 0);
  }

  #fit(): void {
    const { clientWidth, clientHeight } = this.#host;
    if (!clientWidth || !clientHeight) return;
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, this.#detail === "low" ? 1 : 2));
    this.#renderer.setSize(clientWidth, clientHeight, false);
    this.#eye.resize(clientWidth, clientHeight);
    this.#ask();
  }

  /** Where the character stands that goes through the world; the verb's origin for others. */
  #home(): Vector3 {
    const main = this.#figures?.main;
    return this.#place?.carried && main?.count ? new Vector3().fromArray(main.places).setY(0) : new Vector3();
  }

  /** Draw once, soon. */
  #ask(): void {
    if (!this.#request) this.#request = requestAnimationFrame((now) => this.#draw(now));
  }

  #draw(now: number): void {
    this.#request = 0;
    const delta_s = Math.min((now - this.#drawnAt) / 1000, 0.1);
    this.#drawnAt = now;
    const moving = this.#go(delta_s);
    if (this.#eye.controls.update(delta_s) || moving) this.#ask();
    this.#look();
    this.#renderer.render(this.#scene, this.#eye.camera);
    this.drawn.frames += 1;
    this.drawn.goal = this.#goal.shown ? this.#goal.world.toArray() : null;
    this.drawn.handle = this.#goal.shown ? this.#pointer.inWindow(this.#goal.world) : null;
  }

  /** Move what goes with the character; whether it is still on its way. */
  #go(delta_s: number): boolean {
    const main = this.#figures?.main;
    let moving = false;
    if (main?.count) {
      if (this.#place?.kind === "velocity" && !this.#pointer.dragging) {
        moving = this.#carried.strides(main.places, main.turns, delta_s);
      }
      const root = new Vector3().fromArray(main.places);
      if (this.#eye.follow(this.#following ? root : null, delta_s)) moving = true;
    }
    this.#frame.position.set(this.#carried.x, 0, this.#carried.z);
    this.#frame.rotation.y = this.#carried.heading;
    this.#frame.updateMatrixWorld(true);
    return moving;
  }

  /** Put everything that depends on the camera where it belongs. */
  #look(): void {
    const { camera, controls } = this.#eye;
    const { target } = controls;
    camera.updateMatrixWorld();
    this.#goal.face(camera, this.#host.clientHeight);
    if (this.#layout) {
      const { light, radius, bar } = this.#layout;
      const main = this.#figures?.main;
      const [x, y, z] = main?.count ? main.places : [target.x, target.y, target.z];
      const snap = (value: number | undefined) => Math.round((value ?? 0) * 4) / 4;
      const crowd = this.#layout.crowd(main?.count ?? 1);
      this.#lights.aim(snap(x) + crowd.x, snap(y) + crowd.y, snap(z) + crowd.z, radius(main?.count ?? 1), light);
      this.#ground.centre(target.x, target.y, target.z);
      const [u, v] = this.#following && main?.count ? [Math.round(x ?? 0), Math.round(z ?? 0)] : [0, 0];
      this.#ground.putBar(bar[0] + u, bar[1] + v);
    }
    this.#label();
  }

  #label(): void {
    const { camera } = this.#eye;
    const main = this.#figures?.main;
    const at = this.#effector >= 0 && main?.count ? new Vector3().fromArray(main.places, 3 * this.#effector) : null;
    this.drawn.effector = at?.toArray() ?? null;
    const judged = Math.abs(this.#phase - this.#keytime) < AT_KEYTIME;
    const far = this.#goal.reach(at, judged);
    if (at && this.#goal.shown && judged && far >= 0.001) {
      this.#missLabel.show(distance(far), at.lerp(this.#goal.world, 0.5), camera, 18);
    } else this.#missLabel.hide();
    if (this.#hovered && !this.#pointer.dragging) {
      this.#markLabel.show(this.#hovered.known.name, this.#hovered.at.clone(), camera, 14);
    } else this.#markLabel.hide();
    this.#ground.group.updateMatrixWorld(true);
    this.#barLabel.show("1 m", this.#ground.bar.localToWorld(new Vector3(1, 0, 0)), camera, 8);
  }
}
