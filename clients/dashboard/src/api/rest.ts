/** Typed calls of the REST routes. A failed call throws a `Problem` with the server's code and detail. */

import { draftRest } from "../drafts/api";
import type { components } from "../generated/schema";
import type { Refinement, Rest } from "../types";
import { ifMatch, Problem, request, type Send, sendFile } from "./request";

export { Problem };

const ENDED = new Set(["published", "not_better", "failed", "cancelled", "given_up"]);

/** @param onProblem called with every failed response, before it is thrown */
export function createRest(base = "", onProblem: (problem: Problem) => void = () => {}): Rest {
  const send: Send = (path, init) => request(path, init, onProblem);
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await send(base + path, init)).json();
  const at = (verb: string) => `/v1/verbs/${encodeURIComponent(verb)}`;
  const job = (id: string) => `/v1/refinements/${encodeURIComponent(id)}`;
  return {
    json,
    drafts: draftRest(send, base),
    verbs: async (signal) => (await json<components["schemas"]["VerbList"]>("/v1/verbs", withSignal(signal))).verbs,
    verb: (name, signal) => json(at(name), withSignal(signal)),
    versions: (verb, signal) => json(`${at(verb)}/versions`, withSignal(signal)),
    activate: (verb, version, expected) =>
      json(`${at(verb)}/versions/${version}/activate`, { method: "POST", headers: ifMatch(expected) }),
    upload: (content, ...options) => sendFile(`${base}/v1/verbs`, content, ...options),
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

function postJson(body: unknown, signal?: AbortSignal) {
  return {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
    ...withSignal(signal),
  };
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
