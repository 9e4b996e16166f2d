/** Drafts: folders of clips on their way to a verb. Shapes of JSON come from the generated API types. */

import type { components } from "adverb-client";
import type { Skeleton, Upload } from "../types";

type Schemas = components["schemas"];

export type Draft = Schemas["DraftAnswer"];
export type Clip = Schemas["_DraftClip"];
export type DraftSummary = Schemas["_ListedDraft"];
export type AddedExample = Schemas["ExampleAnswer"];

/** Fields of a request, all optional, without null. */
type Given<Request> = { [Field in keyof Request]?: NonNullable<Request[Field]> };

/** Change of a clip. */
export interface ClipEdit extends Omit<Given<Schemas["DraftClip"]>, "keytimes" | "mends"> {
  /** null: as proposed. */
  keytimes?: number[] | null;
  mends?: { index: number; apply: boolean }[];
}

/** Change of a draft; omitted fields stay. */
export interface DraftEdit extends Omit<Given<Schemas["DraftChange"]>, "adverbs" | "clips"> {
  /** The whole list, in order. */
  adverbs?: Partial<Schemas["_DraftAdverb"]>[];
  clips?: Record<string, ClipEdit>;
}

/** Motion of a clip in its own time: poses at uniform instants from `start` to `end`, s. */
export interface ClipMotion {
  readonly name: string;
  readonly samples: number;
  readonly start: number;
  readonly end: number;
  /** samples × (3 + 4·joints): root x, y, z, then local x, y, z, w per joint. */
  readonly poses: Float32Array;
}

export interface DraftMotion {
  readonly skeleton: Skeleton;
  readonly clips: readonly ClipMotion[];
}

/** Calls of the draft routes; failures throw `AdverbError`. */
export interface DraftRest {
  create(zip: Blob, name: string, progress?: (share: number) => void, signal?: AbortSignal): Promise<Draft>;
  list(): Promise<readonly DraftSummary[]>;
  get(id: string, signal?: AbortSignal): Promise<Draft>;
  motion(id: string, signal?: AbortSignal): Promise<DraftMotion>;
  /** Change a draft whose current revision is `revision`. */
  change(id: string, edit: DraftEdit, revision: number): Promise<Draft>;
  /** Sequence at a goal as binary records (docs/wire.md). */
  sequence(id: string, adverbs: Readonly<Record<string, number>>, fps: number): Promise<ArrayBuffer>;
  publish(id: string, name: string): Promise<Upload>;
  remove(id: string): Promise<void>;
  addExample(verb: string, clip: File, progress?: (share: number) => void): Promise<AddedExample>;
}
