/** Requests to the server. A failed one throws a `Problem` with the server's code and detail. */

import type { Access } from "../access/access";
import type { components } from "../generated/schema";

type ProblemBody = components["schemas"]["ProblemAnswer"];

const ZIP = [0x50, 0x4b];
const UNAUTHENTICATED = 401;

/** A failed request. Status 0 with code `offline` means that no response arrived. */
export class Problem extends Error {
  override readonly name = "Problem";
  constructor(
    readonly status: number,
    readonly code: string,
    readonly detail: string,
    /** Valid names, for `unknown_…` codes. */
    readonly known: readonly string[] = [],
    /** Time after which the request may be repeated, ms; 0: not stated. */
    readonly retryMs = 0,
  ) {
    super(detail);
  }
}

/** Time before the next request after a failed one, ms: what the response states, or a default. */
export function retryMs(err: unknown, otherwise: number): number {
  return err instanceof Problem ? Math.max(err.retryMs, otherwise) : otherwise;
}

/** Fetch with the key of this tab that throws a `Problem` for a failed response. */
export type Send = (path: string, init?: RequestInit) => Promise<Response>;

export function bearer(key: string): Record<string, string> {
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/** Send with the key of this tab; after a 401, wait for another key and send again. */
export async function withKey<T>(
  access: Access | null,
  signal: AbortSignal | null | undefined,
  send: (key: string) => Promise<T>,
): Promise<T> {
  for (;;) {
    const key = (await access?.usable(signal)) ?? "";
    try {
      return await send(key);
    } catch (err) {
      if (!access || !(err instanceof Problem) || err.status !== UNAUTHENTICATED) throw err;
      access.refuse(key, err.detail);
    }
  }
}

export async function request(path: string, init: RequestInit | undefined, key: string): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, { ...init, headers: { ...plain(init?.headers), ...bearer(key) } });
  } catch (err) {
    if (err instanceof DOMException && err.name === "AbortError") throw err;
    throw offline();
  }
  if (response.ok) return response;
  throw problemOf(response.status, await response.text(), response.headers.get("Retry-After"));
}

function plain(headers: RequestInit["headers"]): Record<string, string> {
  return Object.fromEntries(new Headers(headers));
}

function offline(): Problem {
  return new Problem(0, "offline", "no response from the server");
}

/** @param retryAfter seconds, as in the header */
export function problemOf(status: number, text: string, retryAfter: string | null = null): Problem {
  const seconds = Number(retryAfter) || 0;
  try {
    const body = JSON.parse(text) as Partial<ProblemBody>;
    const errors = body.errors?.map(({ at, problem }) => `${at}: ${problem}`).join("; ");
    const wait = body.code === "too_many_requests" && seconds > 0 ? `wait ${seconds} s` : "";
    const detail = [body.detail ?? body.title ?? `HTTP status ${status}`, errors, wait].filter(Boolean).join(": ");
    return new Problem(status, body.code ?? "unknown", detail, body.known ?? [], 1000 * seconds);
  } catch {
    return new Problem(status, "unknown", `HTTP status ${status}`, [], 1000 * seconds);
  }
}

/** Header that names the version or revision to be changed. */
export function ifMatch(version: number | undefined): Record<string, string> {
  return version === undefined ? {} : { "If-Match": `"${version}"` };
}

/** Upload of a file; the answer is JSON. */
export type SendFile = <Answer>(
  path: string,
  content: Blob,
  progress?: (share: number) => void,
  signal?: AbortSignal,
  expected?: number,
) => Promise<Answer>;

/** Uploads by XMLHttpRequest, which reports progress. */
export function fileSender(access: Access | null): SendFile {
  return async <Answer>(
    path: string,
    content: Blob,
    progress?: (share: number) => void,
    signal?: AbortSignal,
    expected?: number,
  ) => {
    const first = new Uint8Array(await content.slice(0, 2).arrayBuffer());
    const kind = ZIP.every((byte, k) => first[k] === byte) ? "application/zip" : "application/octet-stream";
    const headers = { "Content-Type": kind, ...ifMatch(expected) };
    return withKey(access, signal, (key) =>
      post<Answer>(path, content, { ...headers, ...bearer(key) }, progress, signal),
    );
  };
}

function post<Answer>(
  path: string,
  content: Blob,
  headers: Record<string, string>,
  progress?: (share: number) => void,
  signal?: AbortSignal,
): Promise<Answer> {
  return new Promise<Answer>((done, failed) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = ({ loaded, total }) => progress?.(total > 0 ? loaded / total : 0);
    request.onerror = () => failed(offline());
    request.onabort = () => failed(new DOMException("upload cancelled", "AbortError"));
    request.onload = () => {
      if (request.status < 300) done(JSON.parse(request.responseText) as Answer);
      else failed(problemOf(request.status, request.responseText, request.getResponseHeader("Retry-After")));
    };
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    request.send(content);
  });
}
