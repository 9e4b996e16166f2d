/** Typed calls of the REST routes. A failed call throws a `Problem` with the server's code and detail. */

import type { Access } from "../access/access";
import { draftRest } from "../drafts/api";
import type { components } from "../generated/schema";
import type { Refinement, Rest } from "../types";
import { follow } from "./events";
import { fileSender, ifMatch, Problem, request, type Send, withKey } from "./request";

export { Problem };

const ENDED = new Set(["published", "not_better", "failed", "cancelled", "given_up"]);

/**
 * @param access the key of this tab; null sends none
 * @param onProblem called with every failed response, before it is thrown
 */
export function createRest(
  base = "",
  access: Access | null = null,
  onProblem: (problem: Problem) => void = () => {},
): Rest {
  const send: Send = async (path, init) => {
    try {
      return await withKey(access, init?.signal, (key) => request(path, init, key));
    } catch (err) {
      if (err instanceof Problem && err.status > 0) onProblem(err);
      throw err;
    }
  };
  const sendFile = fileSender(access);
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await send(base + path, init)).json();
  const at = (verb: string) => `/v1/verbs/${encodeURIComponent(verb)}`;
  const job = (id: string) => `/v1/refinements/${encodeURIComponent(id)}`;
  return {
    json,
    drafts: draftRest(send, sendFile, base),
    verbs: async (signal) => (await json<components["schemas"]["VerbList"]>("/v1/verbs", withSignal(signal))).verbs,
    verb: (name, signal) => json(at(name), withSignal(signal)),
    versions: (verb, signal) => json(`${at(verb)}/versions`, withSignal(signal)),
    activate: (verb, version, expected) =>
      json(`${at(verb)}/versions/${version}/activate`, { method: "POST", headers: ifMatch(expected) }),
    upload: (content, ...options) => sendFile(`${base}/v1/verbs`, content, ...options),
    remove: async (verb) => void (await send(base + at(verb), { method: "DELETE" })),
    download: async (path, signal) => (await send(base + path, withSignal(signal))).blob(),
    artifact: (verb, version) => `${at(verb)}/versions/${version}`,
    refine: (verb, request) => json(`${at(verb)}/refinements`, postJson(request)),
    refinements: async (query = {}, signal) => {
      const params = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
      const path = `/v1/refinements${params.size > 0 ? `?${params}` : ""}`;
      return (await json<components["schemas"]["RefinementList"]>(path, withSignal(signal))).refinements;
    },
    refinement: (id, signal) => json(job(id), withSignal(signal)),
    cancel: (id) => json(job(id), { method: "DELETE" }),
    follow: (id, then) =>
      follow(send, `${base}${job(id)}/events`, (data) => {
        const refinement = JSON.parse(data) as Refinement;
        const end = ENDED.has(refinement.state);
        then(refinement, end);
        return end;
      }),
    changes: async (query, signal) => {
      const params = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
      return (await json<components["schemas"]["AuditAnswer"]>(`/v1/audit?${params}`, withSignal(signal))).changes;
    },
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

/** The holder of a key; throws a `Problem` if the server refuses it. */
export async function callerOf(key: string, base = ""): Promise<components["schemas"]["AccessAnswer"]> {
  return (await request(`${base}/v1/access`, undefined, key)).json();
}
