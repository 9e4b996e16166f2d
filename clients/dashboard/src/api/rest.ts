/** Typed calls of the REST routes. A failed call throws a `Problem` with the server's code and detail. */

import type { components } from "../generated/schema";
import type { Refinement, Rest, Upload } from "../types";

type ProblemBody = components["schemas"]["ProblemAnswer"];

const ZIP = [0x50, 0x4b];
const ENDED = new Set(["published", "not_better", "failed", "cancelled", "given_up"]);

/** A failed request. Status 0 with code `offline` means that no response arrived. */
export class Problem extends Error {
  override readonly name = "Problem";
  constructor(
    readonly status: number,
    readonly code: string,
    readonly detail: string,
    /** Valid names, for `unknown_…` codes. */
    readonly known: readonly string[] = [],
  ) {
    super(detail);
  }
}

/** @param onProblem called with every failed response, before it is thrown */
export function createRest(base = "", onProblem: (problem: Problem) => void = () => {}): Rest {
  const send = (path: string, init?: RequestInit) => request(path, init, onProblem);
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await send(base + path, init)).json();
  const at = (verb: string) => `/v1/verbs/${encodeURIComponent(verb)}`;
  const job = (id: string) => `/v1/refinements/${encodeURIComponent(id)}`;
  return {
    json,
    verbs: async (signal) => (await json<components["schemas"]["VerbList"]>("/v1/verbs", withSignal(signal))).verbs,
    verb: (name, signal) => json(at(name), withSignal(signal)),
    versions: (verb, signal) => json(`${at(verb)}/versions`, withSignal(signal)),
    activate: (verb, version, expected) =>
      json(`${at(verb)}/versions/${version}/activate`, { method: "POST", headers: ifMatch(expected) }),
    upload: (content, ...options) => upload(`${base}/v1/verbs`, content, ...options),
    remove: async (verb) => void (await send(base + at(verb), { method: "DELETE" })),
    artifact: (verb, version) => `${base}${at(verb)}/versions/${version}`,
    refine: (verb, request) => json(`${at(verb)}/refinements`, postJson(request)),
    refinements: async (query = {}, signal) => {
      const params = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
      const path = `/v1/refinements${params.size > 0 ? `?${params}` : ""}`;
      return (await json<components["schemas"]["RefinementList"]>(path, withSignal(signal))).refinements;
    },
    refinement: (id, signal) => json(job(id), withSignal(signal)),
    cancel: (id) => json(job(id), { method: "DELETE" }),
    follow: (id, then) => follow(`${base}${job(id)}/events`, then),
    pose: (verb, request, signal) => json(`${at(verb)}/pose`, postJson(request, signal)),
    poses: async (verb, request, signal) =>
      (await json<components["schemas"]["PosesAnswer"]>(`${at(verb)}/poses`, postJson(request, signal))).poses,
    sequence: async (verb, request, signal) => {
      const init = postJson(request, signal);
      const headers = { ...init.headers, Accept: "application/octet-stream" };
      return (await send(`${base}${at(verb)}/sequence`, { ...init, headers })).arrayBuffer();
    },
    ready: (signal) => json("/readyz", withSignal(signal)),
    metrics: async (signal) => (await send(`${base}/metrics`, withSignal(signal))).text(),
  };
}

function withSignal(signal: AbortSignal | undefined): RequestInit {
  return signal ? { signal } : {};
}

function ifMatch(version: number | undefined): Record<string, string> {
  return version === undefined ? {} : { "If-Match": `"${version}"` };
}

function postJson(body: unknown, signal?: AbortSignal) {
  return {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
    ...withSignal(signal),
  };
}

async function request(
  path: string,
  init: RequestInit | undefined,
  onProblem: (problem: Problem) => void,
): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, init);
  } catch (err) {
    if (err instanceof DOMException && err.name === "AbortError") throw err;
    throw offline();
  }
  if (response.ok) return response;
  const problem = problemOf(response.status, await response.text());
  onProblem(problem);
  throw problem;
}

function offline(): Problem {
  return new Problem(0, "offline", "no response from the server");
}

function problemOf(status: number, text: string): Problem {
  try {
    const body = JSON.parse(text) as Partial<ProblemBody>;
    const details = body.errors?.map(({ at, problem }) => `${at}: ${problem}`).join("; ");
    const detail = [body.detail ?? body.title ?? `HTTP status ${status}`, details].filter(Boolean).join(": ");
    return new Problem(status, body.code ?? "unknown", detail, body.known ?? []);
  } catch {
    return new Problem(status, "unknown", `HTTP status ${status}`);
  }
}

/** Upload a file with XMLHttpRequest, which reports upload progress. */
async function upload(
  path: string,
  content: Blob,
  progress?: (share: number) => void,
  signal?: AbortSignal,
  expected?: number,
): Promise<Upload> {
  const first = new Uint8Array(await content.slice(0, 2).arrayBuffer());
  const kind = ZIP.every((byte, k) => first[k] === byte) ? "application/zip" : "application/octet-stream";
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    const headers = { "Content-Type": kind, ...ifMatch(expected) };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = ({ loaded, total }) => progress?.(total > 0 ? loaded / total : 0);
    request.onerror = () => failed(offline());
    request.onabort = () => failed(new DOMException("upload cancelled", "AbortError"));
    request.onload = () => {
      if (request.status < 300) done(JSON.parse(request.responseText) as Upload);
      else failed(problemOf(request.status, request.responseText));
    };
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    request.send(content);
  });
}

function follow(path: string, then: (refinement: Refinement, end: boolean) => void): () => void {
  const events = new EventSource(path);
  const take = ({ data }: MessageEvent<string>) => {
    const refinement = JSON.parse(data) as Refinement;
    const end = ENDED.has(refinement.state);
    if (end) events.close();
    then(refinement, end);
  };
  events.addEventListener("progress", take);
  events.addEventListener("end", take);
  return () => events.close();
}
