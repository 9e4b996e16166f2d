/** Types of the server's JSON, by the names that this package uses. */

import type { components } from "./generated/schema.js";

type Schemas = components["schemas"];

export type Verb = Schemas["VerbAnswer"];
export type VerbSummary = Schemas["VerbSummary"];
export type Version = Schemas["VersionAnswer"];
export type Versions = Schemas["VersionsAnswer"];
export type Refinement = Schemas["RefinementAnswer"];
export type RefinementRequest = Schemas["RefinementRequest"];
export type Upload = Schemas["UploadAnswer"];
export type Ready = Schemas["Ready"];
export type Change = Schemas["_ChangeOfVerb"];
export type Caller = Schemas["AccessAnswer"];
export type Quality = Schemas["QualityAnswer"];
export type PoseAnswer = Schemas["PoseAnswer"];
export type SequenceAnswer = Schemas["SequenceAnswer"];
/** Answer of the server to `open` and `switch`. */
export type Opened = Schemas["Opened"];
/** Report of a connection with a byte budget. */
export type BudgetReport = Schemas["Stats"];

export type PoseRequest = PartialRequest<Schemas["PoseRequest"], "adverbs">;
export type PosesRequest = PartialRequest<Schemas["BatchRequest"], "items">;
export type SequenceRequest = PartialRequest<Schemas["SequenceRequest"], never>;

/** Request with optional fields, except for those named. */
type PartialRequest<Request, Required extends keyof Request> = Pick<Request, Required> &
  Partial<Omit<Request, Required>>;
