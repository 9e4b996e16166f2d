/**
 * What the parts of the page say to each other. Types only.
 *
 * Data flows one way: stream worker → frames → stage; controls → view → stream. The view is the one place that holds
 * what the page shows; all of it stands in the URL.
 */

import type { components } from "./generated/schema";

export type Verb = components["schemas"]["VerbAnswer"];
export type VerbSummary = components["schemas"]["VerbSummary"];
export type Version = components["schemas"]["VersionAnswer"];
export type Versions = components["schemas"]["VersionsAnswer"];
export type Refinement = components["schemas"]["RefinementAnswer"];
export type RefinementRequest = components["schemas"]["RefinementRequest"];
export type Upload = components["schemas"]["UploadAnswer"];
export type Ready = components["schemas"]["Ready"];
export type Opened = components["schemas"]["Opened"];

/** What is set beside the character: nothing, another method, or another version at the same goal. */
export type Against = { kind: "nothing" } | { kind: "method"; method: string } | { kind: "version"; version: number };

export type Panel = "verb" | "quality" | "versions" | "service" | "add";

/** Everything that the page shows; a link holds it all. */
export interface View {
  verb: string;
  /** Empty: the verb's own. */
  method: string;
  /** Adverbs by name, in the verb's units. */
  goal: Readonly<Record<string, number>>;
  /** 0–1; where the motion stands while it does not play. */
  phase: number;
  playing: boolean;
  speed: number;
  loop: boolean;
  fps: number;
  encoding: "f32" | "q48";
  /** Characters, 1–1,000. */
  crowd: number;
  against: Against;
  hull: boolean;
  examples: boolean;
  pseudo: boolean;
  /** Whether the camera goes with the character. */
  follow: boolean;
  detail: "high" | "low";
  theme: "auto" | "light" | "dark";
  panel: Panel;
  /** Eye x, y, z and target x, y, z; null: chosen by the stage. */
  camera: readonly number[] | null;
  /** Quality maps: adverbs on the axes, empty: the first two; what is drawn. */
  across: string;
  up: string;
  map: "error" | "smoothness";
  /** Methods of the quality maps, empty: chosen by the page. */
  maps: readonly string[];
  /** Where the slice of the maps is, by adverb; null: through the goal. */
  slice: Readonly<Record<string, number>> | null;
}

export interface Store {
  readonly view: View;
  change(part: Partial<View>): void;
  /** Calls `then` after any of the keys changed; returns how to stop. */
  on(keys: readonly (keyof View)[], then: (view: View, before: View) => void): () => void;
}

/** A verb's skeleton, as the REST description gives it. */
export type Skeleton = Verb["skeleton"];

/** One picture of some characters on one skeleton; arrays may be reused after `Stage.show` returns. */
export interface Picture {
  count: number;
  /** count × (3 + 4·joints): root x, y, z, then local x, y, z, w per joint; glTF axes, metres. */
  poses: Float32Array;
  /** Error of the first character, m; NaN where none. */
  error: number;
  phase: number;
}

/** Which of two things side by side: the one that is steered, and what is set against it. */
export type Side = "main" | "other";

/** What the stage drew last. */
export interface Drawn {
  frames: number;
  /** World positions of the main side's first character's effector, and of the goal, metres. */
  effector: readonly number[] | null;
  goal: readonly number[] | null;
  /** Where the goal's handle is in the window, pixels. */
  handle: readonly [number, number] | null;
}

/** The three-dimensional picture. Knows nothing of the network. */
export interface Stage {
  /** Show another verb: builds mannequins, frames the camera unless the view holds one. */
  setVerb(verb: Verb): void;
  show(side: Side, picture: Picture | null): void;
  /** Where the goal is in adverbs; drawn where the verb's measured adverbs are a place (see `place.ts`). */
  setGoal(goal: Readonly<Record<string, number>>): void;
  setMarks(marks: { hull: boolean; examples: boolean; pseudo: boolean }): void;
  setFollow(follow: boolean): void;
  setDetail(detail: "high" | "low"): void;
  setTheme(dark: boolean): void;
  setCamera(camera: readonly number[] | null): void;
  /** Pixels at the right and below that something else covers. */
  setAside(right: number, bottom: number): void;
  resetView(): void;
  /** The goal was dragged to these adverbs, inside the domain or not; `done` when the pointer was let go. */
  onGoal: (goal: Record<string, number>, done: boolean) => void;
  /** An example (or pseudo-example) was chosen. */
  onExample: (adverbs: Readonly<Record<string, number>>) => void;
  onCamera: (camera: readonly number[]) => void;
  /** What was drawn last: for tests and for the readout. */
  readonly drawn: Drawn;
  dispose(): void;
}

/** How the connection is: never opened yet, there, being sought again, given up because the page goes. */
export type Connection = "connecting" | "open" | "lost" | "closed";

/** What the stream did in the last quarter of a second, and since the page was opened. */
export interface Stats {
  connection: Connection;
  messages_per_s: number;
  poses_per_s: number;
  bytes_per_s: number;
  /** Since the page was opened: messages that the server left out, jumps of the sequence number, connections again. */
  dropped: number;
  gaps: number;
  reconnects: number;
  /** Age of pose messages on arrival, by the server's clock, ms; NaN before the first. */
  lateness_p50_ms: number;
  lateness_p95_ms: number;
  lateness_p99_ms: number;
  round_trip_ms: number;
  /** How much later than the earliest possible the picture is shown, ms. */
  buffer_ms: number;
  /** Channels that the server has open for this page. */
  channels: number;
}

/** What is known of the first character of a side in the picture that is shown. */
export interface Shown {
  verb: string;
  version: number;
  method: string;
  phase: number;
  time_s: number;
  duration_s: number;
  /** In the unit of the verb's measure (m, m/s); NaN where nothing is measured. */
  error: number;
  clamped: boolean;
  inTransition: boolean;
  /** x, y, z, metres. */
  root: readonly [number, number, number];
  /** Characters in the picture. */
  count: number;
}

/** The page, as its panels see it. */
export interface App {
  readonly store: Store;
  readonly rest: Rest;
  /** The verbs that are served; empty before the server has answered. */
  readonly verbs: readonly VerbSummary[];
  /** The description of the verb that the view names, in its current version; null while it is being loaded. */
  readonly verb: Verb | null;
  /** What the stream says of the steered character's channel; null before its first answer. */
  readonly opened: Opened | null;
  readonly connection: Connection;
  readonly stats: Stats | null;
  /** What is shown on either side; null before the first picture. */
  readonly shown: Readonly<Record<Side, Shown | null>>;
  /** Calls `then` whenever it happens; returns how to stop. */
  on<Name extends keyof AppEvents>(event: Name, then: (what: AppEvents[Name]) => void): () => void;
  /** Ask again for the verbs and the current description: after an upload, a deletion, an activation. */
  reload(): Promise<void>;
  /** Say something to the user for a few seconds; errors stay until they are dismissed. */
  say(text: string, kind?: "note" | "error"): void;
}

export interface AppEvents {
  /** The description changed: another verb, or another version of it. */
  verb: Verb;
  /** The list of verbs changed. */
  verbs: readonly VerbSummary[];
  opened: Opened;
  connection: Connection;
  /** Four times a second. */
  stats: Stats;
  /** Once per picture of the main side. The object is reused: copy what is kept. */
  frame: Shown;
  /** A keytime passed on the steered character. */
  event: { name: string; phase: number };
}

/** Typed calls of the server's routes; every failure is a `Problem` (`api/rest.ts`). */
export interface Rest {
  verbs(signal?: AbortSignal): Promise<VerbSummary[]>;
  verb(name: string, signal?: AbortSignal): Promise<Verb>;
  versions(verb: string, signal?: AbortSignal): Promise<Versions>;
  /** Serve a version; only while `expected` is served, where it is given. */
  activate(verb: string, version: number, expected?: number): Promise<Version>;
  /**
   * An artifact, or a zip of a verb source; which of them is seen from its first bytes. `expected`: the version that
   * it may replace.
   */
  upload(content: Blob, progress?: (share: number) => void, signal?: AbortSignal, expected?: number): Promise<Upload>;
  remove(verb: string): Promise<void>;
  /** The address of a version's artifact, to be downloaded. */
  artifact(verb: string, version: number): string;
  refine(verb: string, asked: Partial<RefinementRequest>): Promise<Refinement>;
  refinements(asked?: { verb?: string; limit?: number }, signal?: AbortSignal): Promise<Refinement[]>;
  refinement(id: string, signal?: AbortSignal): Promise<Refinement>;
  cancel(id: string): Promise<Refinement>;
  /** Follow a refinement until it ends or `stop` is called; lost connections are taken up again by the browser. */
  follow(id: string, then: (refinement: Refinement, end: boolean) => void): () => void;
  /** One pose; for maps and probes. */
  pose(verb: string, asked: PoseRequest, signal?: AbortSignal): Promise<PoseAnswer>;
  /** Many poses; JSON. */
  poses(verb: string, asked: PosesRequest, signal?: AbortSignal): Promise<PoseAnswer[]>;
  /** A whole motion as binary records (docs/wire.md), of any kept version. */
  sequence(verb: string, asked: SequenceRequest, signal?: AbortSignal): Promise<ArrayBuffer>;
  ready(signal?: AbortSignal): Promise<Ready>;
  /** Prometheus text. */
  metrics(signal?: AbortSignal): Promise<string>;
  /** Any other JSON route below `/v1`, with problems as errors. */
  json<T>(path: string, init?: RequestInit): Promise<T>;
}

export type PoseAnswer = components["schemas"]["PoseAnswer"];
export type PoseRequest = Asked<components["schemas"]["PoseRequest"], "adverbs">;
export type PosesRequest = Asked<components["schemas"]["BatchRequest"], "items">;
export type SequenceRequest = Asked<components["schemas"]["SequenceRequest"], never>;

/** A request of which only some fields must be given. */
type Asked<Request, Needed extends keyof Request> = Pick<Request, Needed> & Partial<Omit<Request, Needed>>;
