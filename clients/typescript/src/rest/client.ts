/** Typed calls of the REST routes. A failed call throws an `AdverbError` with the server's code and detail. */

import { ResponseError, TimedOut, TransportError, Unavailable } from "../errors.js";
import type {
  Caller,
  Change,
  PoseAnswer,
  PoseRequest,
  PosesRequest,
  Quality,
  Ready,
  Refinement,
  RefinementRequest,
  SequenceRequest,
  Upload,
  Verb,
  VerbSummary,
  Version,
  Versions,
} from "../schema.js";
import { follow } from "./events.js";
import { ifMatch, jsonBody, readBody, request, retryMs, type Send } from "./request.js";
import type { Answer, CallOptions, Method, PathOf } from "./routes.js";

const ENDED = new Set(["published", "not_better", "failed", "cancelled", "given_up"]);
const OCTETS = "application/octet-stream";
const ZIP = [0x50, 0x4b];
const READY_MS = 250;
const TIMEOUT_MS = 30_000;
/** Limit of uploads, which build verbs, and of downloads of whole files, ms. */
const LONG_MS = 300_000;

/** Media types of a whole motion. */
export type MotionType =
  | "application/octet-stream"
  | "model/gltf-binary"
  | "application/x-vrma"
  | "text/x-bvh"
  | "application/x-npz";

export interface ClientOptions {
  /** Key of the server; none by default. */
  key?: string | null | undefined;
  /** Replacement of `fetch`. */
  fetch?: typeof fetch | undefined;
  /** Time in which a response has to be complete, ms (30,000); uploads and downloads of files have 5 min. */
  timeoutMs?: number | undefined;
  /** Replacement of the whole request, as for authentication by other means; then the other options do not count. */
  send?: Send | undefined;
}

/** REST client of a server. */
export class Client {
  /** Address without a slash at the end; empty: the page's own server. */
  readonly base: string;
  readonly send: Send;
  /** Key of further requests; null: none. */
  key: string | null;
  private readonly timeoutMs: number;

  constructor(base = "", { key = null, fetch: fetcher, timeoutMs = TIMEOUT_MS, send }: ClientOptions = {}) {
    this.base = base.replace(/\/+$/, "");
    this.key = key;
    this.timeoutMs = send ? Number.POSITIVE_INFINITY : timeoutMs;
    this.send = send ?? ((address, init) => request(address, init, this.key ?? "", fetcher));
  }

  /** Any route of the OpenAPI document, with its types; returns the JSON of the response. */
  async call<M extends Method, P extends PathOf<M>>(
    method: M,
    path: P,
    options: CallOptions<M, P> = {},
  ): Promise<Answer<M, P>> {
    const read = (response: Response) => (response.status === 204 ? Promise.resolve() : response.json());
    const init = initOf(method, options);
    return (await this.read(this.addressOf(path, options), init, read, options.timeoutMs)) as Answer<M, P>;
  }

  /** JSON of any other path below the server. */
  async json<T>(path: string, init?: RequestInit): Promise<T> {
    return (await this.read(this.base + path, init, (response) => response.json())) as T;
  }

  /** Content of a path below the server, such as an artifact. */
  download(path: string, signal?: AbortSignal): Promise<Blob> {
    return this.read(this.base + path, withSignal(signal), (response) => response.blob(), LONG_MS);
  }

  async verbs(signal?: AbortSignal): Promise<VerbSummary[]> {
    return (await this.call("get", "/v1/verbs", { signal })).verbs;
  }

  verb(name: string, signal?: AbortSignal): Promise<Verb> {
    return this.call("get", "/v1/verbs/{verb}", { path: { verb: name }, signal });
  }

  /** One pose. */
  pose(verb: string, body: PoseRequest, signal?: AbortSignal): Promise<PoseAnswer> {
    return this.call("post", "/v1/verbs/{verb}/pose", { path: { verb }, body, signal });
  }

  /** Many poses, as JSON. */
  async poses(verb: string, body: PosesRequest, signal?: AbortSignal): Promise<PoseAnswer[]> {
    return (await this.call("post", "/v1/verbs/{verb}/poses", { path: { verb }, body, signal })).poses;
  }

  /** Whole motion as binary records (`Sequence` reads them), glTF, VRM animation, BVH or npz; of any stored version. */
  sequence(
    verb: string,
    body: SequenceRequest,
    signal?: AbortSignal,
    accept: MotionType = OCTETS,
  ): Promise<ArrayBuffer> {
    const options = { path: { verb }, body, headers: { Accept: accept }, signal };
    const path = "/v1/verbs/{verb}/sequence";
    return this.read(this.addressOf(path, options), initOf("post", options), (response) => response.arrayBuffer());
  }

  /** Map of error, smoothness or support over two adverbs. */
  quality(
    verb: string,
    query: { method?: string; across?: string; up?: string; nodes?: number } = {},
  ): Promise<Quality> {
    return this.call("get", "/v1/verbs/{verb}/quality", { path: { verb }, query });
  }

  versions(verb: string, signal?: AbortSignal): Promise<Versions> {
    return this.call("get", "/v1/verbs/{verb}/versions", { path: { verb }, signal });
  }

  /** Activate a version; with `expected`, only if that version is current. */
  activate(verb: string, version: number, expected?: number): Promise<Version> {
    const path = "/v1/verbs/{verb}/versions/{number}/activate";
    return this.call("post", path, { path: { verb, number: version }, headers: ifMatch(expected) });
  }

  /** Publish an artifact or a zip of a verb source, detected by the first bytes; `expected` as in `activate`. */
  async upload(content: Blob, expected?: number, signal?: AbortSignal): Promise<Upload> {
    const headers = { "Content-Type": await mediaTypeOf(content), ...ifMatch(expected) };
    return this.call("post", "/v1/verbs", { body: content, headers, signal, timeoutMs: LONG_MS });
  }

  /** Stop serving a verb. */
  async remove(verb: string, expected?: number): Promise<void> {
    await this.call("delete", "/v1/verbs/{verb}", { path: { verb }, headers: ifMatch(expected) });
  }

  /**
   * The verb file that is served, for `Evaluator.load`.
   *
   * @param version this one instead; servers without a store have no other than the served one
   */
  verbFile(
    verb: string,
    { version, signal }: { version?: number | undefined; signal?: AbortSignal | undefined } = {},
  ): Promise<ArrayBuffer> {
    const query = version === undefined ? {} : { version };
    const path = this.addressOf("/v1/verbs/{verb}/artifact", { path: { verb }, query });
    return this.read(path, withSignal(signal), (response) => response.arrayBuffer(), LONG_MS);
  }

  /** Path of a version's artifact, for `download`. */
  artifact(verb: string, version: number): string {
    return `/v1/verbs/${encodeURIComponent(verb)}/versions/${version}`;
  }

  refine(verb: string, body: Partial<RefinementRequest>): Promise<Refinement> {
    return this.call("post", "/v1/verbs/{verb}/refinements", { path: { verb }, body });
  }

  async refinements(query: { verb?: string; limit?: number } = {}, signal?: AbortSignal): Promise<Refinement[]> {
    return (await this.call("get", "/v1/refinements", { query, signal })).refinements;
  }

  refinement(id: string, signal?: AbortSignal): Promise<Refinement> {
    return this.call("get", "/v1/refinements/{id}", { path: { id }, signal });
  }

  /** Cancel a refinement. */
  cancel(id: string): Promise<Refinement> {
    return this.call("delete", "/v1/refinements/{id}", { path: { id } });
  }

  /** Follow a refinement until it ends or the returned function is called; reconnects. */
  follow(id: string, then: (refinement: Refinement, end: boolean) => void): () => void {
    return follow(this.send, `${this.base}/v1/refinements/${encodeURIComponent(id)}/events`, (data) => {
      const refinement = JSON.parse(data) as Refinement;
      const end = ENDED.has(refinement.state);
      then(refinement, end);
      return end;
    });
  }

  /** Changes of verbs, the newest first; `before` is the number of the last one of the page before. */
  async changes(
    query: { limit?: number; verb?: string; before?: number } = {},
    signal?: AbortSignal,
  ): Promise<Change[]> {
    return (await this.call("get", "/v1/audit", { query, signal })).changes;
  }

  /** Name, scopes and expiry of the key. */
  access(signal?: AbortSignal): Promise<Caller> {
    return this.call("get", "/v1/access", { signal });
  }

  ready(signal?: AbortSignal): Promise<Ready> {
    return this.call("get", "/readyz", { signal });
  }

  /** Wait until the server has loaded its verbs; throws `TimedOut` if it does not in time. */
  async waitReady(timeoutMs = 60_000): Promise<Ready> {
    const end = Date.now() + timeoutMs;
    for (;;) {
      try {
        return await this.ready();
      } catch (err) {
        const starting = err instanceof TransportError || err instanceof Unavailable;
        if (!starting && !(err instanceof ResponseError && err.status === 503)) throw err;
        const pauseMs = retryMs(err, READY_MS);
        if (Date.now() + pauseMs > end) throw new TimedOut(`the server is not ready after ${timeoutMs / 1000} s`);
        await new Promise((done) => setTimeout(done, pauseMs));
      }
    }
  }

  /** Metrics in Prometheus text format. */
  metrics(signal?: AbortSignal): Promise<string> {
    return this.read(`${this.base}/metrics`, withSignal(signal), (response) => response.text());
  }

  /** Send a request and read its body; throws `TimedOut` if that takes too long. */
  private async read<T>(
    address: string,
    init: RequestInit | undefined,
    content: (response: Response) => Promise<T>,
    timeoutMs = this.timeoutMs,
  ): Promise<T> {
    const given = init?.signal;
    const limit = Number.isFinite(this.timeoutMs) ? AbortSignal.timeout(timeoutMs) : null;
    const signal = limit && given ? AbortSignal.any([given, limit]) : (limit ?? given);
    try {
      return await readBody(content(await this.send(address, { ...init, ...(signal && { signal }) })), signal);
    } catch (err) {
      if (limit?.aborted && !given?.aborted) throw new TimedOut(`no complete response after ${timeoutMs / 1000} s`);
      throw err;
    }
  }

  private addressOf(path: string, { path: names = {}, query }: { path?: unknown; query?: unknown }): string {
    const rows = Object.entries(query ?? {}).filter(([, value]) => value !== undefined && value !== null);
    const text = new URLSearchParams(
      rows.flatMap(([name, value]) => [value].flat().map((each) => [name, String(each)])),
    );
    const known = names as Record<string, string | number>;
    const filled = path.replace(/\{(\w+)\}/g, (_, name: string) => encodeURIComponent(String(known[name])));
    return `${this.base}${filled}${text.size > 0 ? `?${text}` : ""}`;
  }
}

function withSignal(signal: AbortSignal | undefined): RequestInit {
  return signal ? { signal } : {};
}

/** Media type of an upload: a zip of a verb source, or an artifact. */
export async function mediaTypeOf(content: Blob): Promise<string> {
  const first = new Uint8Array(await content.slice(0, 2).arrayBuffer());
  return ZIP.every((byte, k) => first[k] === byte) ? "application/zip" : OCTETS;
}

function initOf(
  method: Method,
  { body, headers, signal }: { body?: unknown; headers?: Record<string, string>; signal?: AbortSignal | undefined },
): RequestInit {
  const verb = method.toUpperCase();
  const binary = body instanceof Blob || body instanceof ArrayBuffer || ArrayBuffer.isView(body);
  if (body === undefined) return { method: verb, ...(headers && { headers }), ...withSignal(signal) };
  if (binary) return { method: verb, body: body as BodyInit, ...(headers && { headers }), ...withSignal(signal) };
  return { ...jsonBody(verb, body, headers), ...withSignal(signal) };
}
