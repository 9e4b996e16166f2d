/** Types of all routes, from the OpenAPI document. */

import type { paths } from "../generated/schema.js";

export type Method = "get" | "post" | "patch" | "delete";

/** Paths with a method. */
export type PathOf<M extends Method> = {
  [P in keyof paths]: paths[P] extends { [K in M]: infer Operation } ? (Operation extends object ? P : never) : never;
}[keyof paths];

type Operation<M extends Method, P extends PathOf<M>> = M extends keyof paths[P] ? paths[P][M] : never;

type ContentOf<Response> = Response extends { content: { "application/json": infer Json } } ? Json : undefined;

type AnswerOf<Responses> = {
  [Status in keyof Responses]: Status extends 200 | 201 | 202 | 204 ? ContentOf<Responses[Status]> : never;
}[keyof Responses];

/** JSON of a successful response; undefined where it has none. */
export type Answer<M extends Method, P extends PathOf<M>> =
  Operation<M, P> extends { responses: infer Responses } ? AnswerOf<Responses> : never;

type Body<O> = O extends { requestBody?: { content: { "application/json": infer Json } } } ? Partial<Json> : BodyInit;

type Parameters<O, Place extends string> = O extends { parameters: { [K in Place]?: infer Given } } ? Given : never;

/** Parts of a request. */
export interface CallOptions<M extends Method, P extends PathOf<M>> {
  /** Names in the path. */
  path?: Parameters<Operation<M, P>, "path">;
  query?: Parameters<Operation<M, P>, "query">;
  /** Sent as JSON, unless it is binary. */
  body?: Body<Operation<M, P>>;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
  /** Time in which the response has to be complete, ms; default: that of the client. */
  timeoutMs?: number;
}
