/** Requests to the server. A failed one throws an `AdverbError` with the server's code and detail. */

import { AdverbError, DecodeError, type ResponseError, responseError, TransportError } from "../errors.js";
import type { components } from "../generated/schema.js";

type ProblemBody = components["schemas"]["ProblemAnswer"];

/** Send a request; throws an `AdverbError` for a failed response. */
export type Send = (address: string, init?: RequestInit) => Promise<Response>;

/** Time before the next request after a failed one, ms: what the response states, or a default. */
export function retryMs(err: unknown, otherwise: number): number {
  return err instanceof AdverbError ? Math.max(err.retryMs, otherwise) : otherwise;
}

/** Header of a key; none for an empty key. */
export function bearer(key: string): Record<string, string> {
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/** Header that names the version or revision to be changed. */
export function ifMatch(version: number | undefined): Record<string, string> {
  return version === undefined ? {} : { "If-Match": `"${version}"` };
}

/** Fetch with a key, empty for none. */
export async function request(
  address: string,
  init: RequestInit | undefined,
  key: string,
  fetcher: typeof fetch = fetch,
): Promise<Response> {
  let response: Response;
  const headers = { ...Object.fromEntries(new Headers(init?.headers)), ...bearer(key) };
  try {
    response = await fetcher(address, { ...init, headers });
  } catch (err) {
    if (init?.signal?.aborted) throw init.signal.reason;
    throw new TransportError(undefined, undefined, { cause: err });
  }
  if (response.ok) return response;
  const { headers: given } = response;
  const text = await readBody(response.text(), init?.signal);
  throw errorOf(response.status, text, given.get("Retry-After"), given.get("X-Request-ID"));
}

/**
 * Content of a body that is being read.
 *
 * @throws TransportError the connection broke before the end
 * @throws DecodeError the content is not JSON
 */
export async function readBody<T>(content: Promise<T>, signal?: AbortSignal | null): Promise<T> {
  try {
    return await content;
  } catch (err) {
    if (signal?.aborted) throw signal.reason;
    if (err instanceof SyntaxError) throw new DecodeError(0, "the response is not JSON");
    throw new TransportError("the connection broke during the response", undefined, { cause: err });
  }
}

/** The error of a failed response; @param retryAfter seconds, as in the header */
export function errorOf(
  status: number,
  text: string,
  retryAfter: string | null = null,
  requestId: string | null = null,
): ResponseError {
  const seconds = Number(retryAfter) || 0;
  let body: Partial<ProblemBody> = {};
  try {
    body = JSON.parse(text) as Partial<ProblemBody>;
  } catch {
    // the detail is the status
  }
  const errors = body.errors?.map(({ at, problem }) => `${at}: ${problem}`).join("; ");
  const wait = body.code === "too_many_requests" && seconds > 0 ? `wait ${seconds} s` : "";
  const detail = [body.detail ?? body.title ?? `HTTP status ${status}`, errors, wait].filter(Boolean).join(": ");
  const { limit, scope } = body;
  const fields = { fieldErrors: body.errors ?? [], limit, scope, requestId };
  return responseError(status, body.code ?? "unknown", detail, body.known ?? [], 1000 * seconds, fields);
}

/** Options of a request with a JSON body. */
export function jsonBody(method: string, body: unknown, headers: Record<string, string> = {}): RequestInit {
  return { method, headers: { "Content-Type": "application/json", ...headers }, body: JSON.stringify(body) };
}
