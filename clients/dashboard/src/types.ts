/**
 * Types shared by the parts of the page.
 *
 * Data flows one way: stream worker → frames → stage; controls → view → stream. The view holds all displayed state
 * and is stored in the URL.
 */

import type { Connection, Opened, Shown, StreamStats, Verb, VerbSummary } from "adverb-client";
import type { Object3D } from "three";
import type { Access } from "./access/access";
import type { Rest } from "./api/rest";
import type { Palette } from "./scene/palette";

export type {
  Change,
  Connection,
  Opened,
  PoseAnswer,
  PoseRequest,
  PosesRequest,
  Ready,
  Refinement,
  RefinementRequest,
  SequenceRequest,
  Shown,
  StreamStats as Stats,
  Upload,
  Verb,
  VerbSummary,
  Version,
  Versions,
} from "adverb-client";
export type { Rest } from "./api/rest";

/** Comparison figure: none, another method, or another version at the same goal. */
export type Comparison = { kind: "none" } | { kind: "method"; method: string } | { kind: "version"; version: number };

export type Panel = "verb" | "quality" | "versions" | "service" | "upload";

/** Complete state of the page; stored in the link. */
export interface View {
  verb: string;
  /** Empty: the verb's default. */
  method: string;
  /** Adverbs by name, in the verb's units. */
  goal: Readonly<Record<string, number>>;
  /** Phase of a paused motion, 0–1. */
  phase: number;
  playing: boolean;
  speed: number;
  loop: boolean;
  fps: number;
  encoding: "f32" | "q48" | "q32";
  /** Number of characters, 1–1,000. */
  crowd: number;
  /** Whether all poses of a crowd are streamed, with planted feet; else weights, which are evaluated here. */
  crowdPoses: boolean;
  compare: Comparison;
  hull: boolean;
  examples: boolean;
  pseudo: boolean;
  /** Whether the camera follows the character. */
  follow: boolean;
  detail: "high" | "low";
  theme: "auto" | "light" | "dark";
  /** Whether keys, gamepad or touch steer the character. */
  drive: boolean;
  panel: Panel;
  /** Identifier of the open draft; empty: a verb is shown. */
  draft: string;
  /** Selected clip of the draft. */
  clip: string;
  /** Name of the figure that this browser keeps and shows; empty: the mannequin. */
  figure: string;
  /** Where the goal of that figure's effector is. */
  figureGoal: "scaled" | "world";
  /** Camera position and target, x, y, z each; null: framed automatically. */
  camera: readonly number[] | null;
  /** Axes of the quality maps (empty: the first two adverbs) and the displayed quantity. */
  across: string;
  up: string;
  map: "error" | "smoothness" | "support";
  /** Methods of the quality maps; empty: default selection. */
  maps: readonly string[];
  /** Fixed adverbs of the maps; null: taken from the goal. */
  slice: Readonly<Record<string, number>> | null;
}

export interface Store {
  readonly view: View;
  /** Change some fields. `push` adds an entry to the browser history instead of replacing the current one. */
  change(part: Partial<View>, push?: boolean): void;
  /** Call `then` after a change of any of the keys; returns the unsubscribe function. */
  on(keys: readonly (keyof View)[], then: (view: View, before: View, push: boolean) => void): () => void;
}

/** Skeleton of a verb, from its REST description. */
export type Skeleton = Verb["skeleton"];

/** Poses of some characters on one skeleton at one instant; arrays may be reused after `Stage.show` returns. */
export interface Picture {
  count: number;
  /** count × (3 + 4·joints): root x, y, z, then local x, y, z, w per joint; glTF axes, metres. */
  poses: Float32Array;
  /** Error of the first character, m; NaN if not measured. */
  error: number;
  phase: number;
}

/** Ground of a looping verb whose cycle climbs. */
export interface Incline {
  /** Rise per metre of horizontal travel. */
  readonly gradient: number;
  /** Height of the root above the ground below it at phases 0, 1/48, … 1, m. */
  readonly heights: Float32Array;
  /** Direction of travel minus the root's heading at the same phases, rad. */
  readonly turns: Float32Array;
}

/** The steered figure, or the comparison beside it. */
export type Role = "main" | "comparison";

/** State of the last drawn frame. */
export interface Drawn {
  frames: number;
  /** World positions of the first character's effector and of the goal, metres. */
  effector: readonly number[] | null;
  goal: readonly number[] | null;
  /** Bounding rectangle of the first character's joints in the canvas, pixels; null if behind the camera. */
  figure: readonly [left: number, top: number, right: number, bottom: number] | null;
  /** Standing points of the first character's feet, and the largest slide of their stances, m; null if none stands. */
  contacts: number;
  slide: number | null;
  /** Lowered level of detail, 0–4 (`scene/detail_control.ts`). */
  detail: number;
  /** Position of the goal handle in the window, pixels. */
  handle: readonly [number, number] | null;
}

/** Where the characters of a crowd are. */
export interface CrowdPlaces {
  readonly count: number;
  /** 3 numbers per character: x, z (m), heading (rad, from +Z toward +X). */
  readonly places: Float32Array;
  /** Characters that need half the frame rate only, by slot; null: none. */
  readonly distant: readonly boolean[] | null;
}

/** Three-dimensional scene; independent of the network. */
export interface Stage {
  /** Switch to another verb: builds mannequins and frames the camera. */
  setVerb(verb: Verb): void;
  /** Other examples, adverbs or measure with the joints of the displayed verb: draws the marks again. */
  updateVerb(verb: Verb): void;
  /** Extreme positions of the verb's motion, m; the automatic camera frames them. */
  setExtent(points: readonly (readonly [number, number, number])[]): void;
  /** Ground of a verb whose cycle climbs; null: level ground. */
  setIncline(incline: Incline | null): void;
  show(role: Role, picture: Picture | null): void;
  /** Goal as adverbs; drawn if they map to a position (see `goal_space.ts`). */
  setGoal(goal: Readonly<Record<string, number>>): void;
  setMarks(marks: { hull: boolean; examples: boolean; pseudo: boolean }): void;
  setFollow(follow: boolean): void;
  /** Drive mode: the camera follows from behind, and goal and marks are hidden. */
  setDrive(drive: boolean): void;
  setDetail(detail: "high" | "low"): void;
  setTheme(dark: boolean): void;
  setCamera(camera: readonly number[] | null): void;
  /** Pixels covered by other elements at the top and at the bottom. */
  setInset(top: number, bottom: number): void;
  resetView(): void;
  /** Another figure stands in place of the first character; null: none. */
  setReplaced(other: Replacement | null): void;
  /** Further objects in the scene, which their owner disposes of. */
  add(objects: Object3D): void;
  /** Draw a frame, as after a change of added objects. */
  requestDraw(): void;
  /** Colours of the current theme. */
  readonly palette: Palette;
  /** The goal was dragged to these adverbs, which may lie outside the domain; `done` at the release. */
  onGoal: (goal: Record<string, number>, done: boolean) => void;
  /** An example or pseudo-example was clicked. */
  onExample: (adverbs: Readonly<Record<string, number>>) => void;
  onCamera: (camera: readonly number[]) => void;
  /** The first character left the picture or came back. */
  onOffscreen: (offscreen: boolean) => void;
  /** Last drawn frame. */
  readonly drawn: Drawn;
  /** Places in the scene of the first figure's characters. */
  readonly crowd: CrowdPlaces;
  dispose(): void;
}

/** Figure that stands in place of the first character. */
export interface Replacement {
  /** Its way over the ground, relative to that of the character. */
  readonly travel: number;
  /** Its goals, relative to those of the verb. */
  readonly goal: number;
  /** World position of its effector, m; null without one. */
  effector(): readonly [number, number, number] | null;
}

/** The page as seen by its panels. */
export interface App {
  readonly store: Store;
  readonly rest: Rest;
  readonly access: Access;
  /** Served verbs; empty before the list is loaded. */
  readonly verbs: readonly VerbSummary[];
  /** Description of the selected verb in its current version; null while loading. */
  readonly verb: Verb | null;
  /** `opened` message of the steered character's channel; null before it arrives. */
  readonly opened: Opened | null;
  readonly connection: Connection;
  readonly stats: StreamStats | null;
  /** Displayed state of each figure; null before the first picture. */
  readonly shown: Readonly<Record<Role, Shown | null>>;
  /** Subscribe to an event; returns the unsubscribe function. */
  on<Name extends keyof AppEvents>(event: Name, then: (event: AppEvents[Name]) => void): () => void;
  /** Reload the verbs and the current description, as after an upload or an activation. */
  reload(): Promise<void>;
  /** Reload the list of verbs if another client changed it. */
  refresh(): Promise<void>;
  /** Remove the key from this tab. */
  forgetKey(): void;
  /** Show a notice for a few seconds; errors stay until dismissed. */
  notify(text: string, kind?: "note" | "error"): void;
}

export interface AppEvents {
  /** The key, or what it permits, changed. */
  access: null;
  /** Another verb, or another version of it, was loaded. */
  verb: Verb;
  /** The list of verbs changed. */
  verbs: readonly VerbSummary[];
  opened: Opened;
  connection: Connection;
  /** Four times per second. */
  stats: StreamStats;
  /** Once per picture of the main figure. The object is reused; copy what you keep. */
  frame: Shown;
  /** The steered character passed a keytime. */
  event: { name: string; phase: number };
}
