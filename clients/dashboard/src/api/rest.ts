/** The server's routes as typed calls; what goes wrong is a `Problem` that says so in the server's own words. */

import type { components } from "../generated/schema";
import type { Refinement, Rest, Upload } from "../types";

type Told = components["schemas"]["ProblemAnswer"];

const ZIP = [0x50, 0x4b];
const ENDED = new Set(["published", "not_better", "failed", "cancelled", "given_up"]);

/** A call that failed. Status 0 and the code `offline`: no answer at all. */
export class Problem extends Error {
  override readonly name = "Problem";
  constructor(
    readonly status: number,
    readonly code: string,
    readonly detail: string,
    /** Names that exist, where that helps. */
    readonly known: readonly string[] = [],
  ) {
    super(detail);
  }
}

export function createRest(base = ""): Rest {
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await ask(base + path, init)).json();
  const at = (verb: string) => `/v1/verbs/${encodeURIComponent(verb)}`;
  const job = (id: string) => `/v1/refinements/${encodeURIComponent(id)}`;
  return {
    json,
    verbs: async (signal) => (await json<components["schemas"]["VerbList"]>("/v1/verbs", from(signal))).verbs,
    verb: (name, signal) => json(at(name), from(signal)),
    versions: (verb, signal) => json(`${at(verb)}/versions`, from(signal)),
    activate: (verb, version, expected) =>
      json(`${at(verb)}/versions/${version}/activate`, { method: "POST", headers: ifMatch(expected) }),
    upload: (content, ...how) => upload(`${base}/v1/verbs`, content, ...how),
    remove: async (verb) => void (await ask(base + at(verb), { method: "DELETE" })),
    artifact: (verb, version) => `${base}${at(verb)}/versions/${version}`,
    refine: (verb, asked) => json(`${at(verb)}/refinements`, posted(asked)),
    refinements: async (asked = {}, signal) => {
      const query = new URLSearchParams(Object.entries(asked).map(([name, value]) => [name, String(value)]));
      const path = `/v1/refinements${query.size > 0 ? `?${query}` : ""}`;
      return (await json<components["schemas"]["RefinementList"]>(path, from(signal))).refinements;
    },
    refinement: (id, signal) => json(job(id), from(signal)),
    cancel: (id) => json(job(id), { method: "DELETE" }),
    follow: (id, then) => follow(`${base}${job(id)}/events`, then),
    pose: (verb, asked, signal) => json(`${at(verb)}/pose`, posted(asked, signal)),
    poses: async (verb, asked, signal) =>
      (await json<components["schemas"]["PosesAnswer"]>(`${at(verb)}/poses`, posted(asked, signal))).poses,
    sequence: async (verb, asked, signal) => {
      const init = posted(asked, signal);
      const headers = { ...init.headers, Accept: "application/octet-stream" };
      return (await ask(`${base}${at(verb)}/sequence`, { ...init, headers })).arrayBuffer();
    },
    ready: (signal) => json("/readyz", from(signal)),
    metrics: async (signal) => (await ask(`${base}/metrics`, from(signal))).text(),
  };
}

function from(signal: AbortSignal | undefined): RequestInit {
  return signal ? { signal } : {};
}

function ifMatch(version: number | undefined): Record<string, string> {
  return version === undefined ? {} : { "If-Match": `"${version}"` };
}

function posted(body: unknown, signal?: AbortSignal) {
  return {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
    ...from(signal),
  };
}

async function ask(path: string, init: RequestInit | undefined): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path, init);
  } catch (err) {
    if (err instanceof DOMException && err.name === "AbortError") throw err;
    throw offline();
  }
  if (!answer.ok) throw problemOf(answer.status, await answer.text());
  return answer;
}

function offline(): Problem {
  return new Problem(0, "offline", "the server does not answer");
}

function problemOf(status: number, text: string): Problem {
  try {
    const told = JSON.parse(text) as Partial<Told>;
    const details = told.errors?.map(({ at, problem }) => `${at}: ${problem}`).join("; ");
    const detail = [told.detail ?? told.title ?? `the server answered ${status}`, details].filter(Boolean).join(": ");
    return new Problem(status, told.code ?? "unknown", detail, told.known ?? []);
  } catch {
    return new Problem(status, "unknown", `the server answered ${status}`);
  }
}

/** Send a file; by an old request object, since only that tells how far it is. */
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
    request.onabort = () => failed(new DOMException("the upload was stopped", "AbortError"));
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
