/** Requests to the server. A failed one throws a `Problem` with the server's code and detail. */

import type { components } from "../generated/schema";

type ProblemBody = components["schemas"]["ProblemAnswer"];

const ZIP = [0x50, 0x4b];

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

/** Fetch that throws a `Problem` for a failed response. */
export type Send = (path: string, init?: RequestInit) => Promise<Response>;

export async function request(
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

/** Header that names the version or revision to be changed. */
export function ifMatch(version: number | undefined): Record<string, string> {
  return version === undefined ? {} : { "If-Match": `"${version}"` };
}

/** Upload a file with XMLHttpRequest, which reports upload progress; the answer is JSON. */
export async function sendFile<Answer>(
  path: string,
  content: Blob,
  progress?: (share: number) => void,
  signal?: AbortSignal,
  expected?: number,
): Promise<Answer> {
  const first = new Uint8Array(await content.slice(0, 2).arrayBuffer());
  const kind = ZIP.every((byte, k) => first[k] === byte) ? "application/zip" : "application/octet-stream";
  return new Promise<Answer>((done, failed) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    const headers = { "Content-Type": kind, ...ifMatch(expected) };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = ({ loaded, total }) => progress?.(total > 0 ? loaded / total : 0);
    request.onerror = () => failed(offline());
    request.onabort = () => failed(new DOMException("upload cancelled", "AbortError"));
    request.onload = () => {
      if (request.status < 300) done(JSON.parse(request.responseText) as Answer);
      else failed(problemOf(request.status, request.responseText));
    };
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    request.send(content);
  });
}
