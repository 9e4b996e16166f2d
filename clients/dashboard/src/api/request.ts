/** Requests with the key of this tab. */

import { bearer, errorOf, ifMatch, mediaTypeOf, NoAccess, TransportError } from "adverb-client";
import type { Access } from "../access/access";

const UNAUTHENTICATED = 401;

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
      if (!access || !(err instanceof NoAccess) || err.status !== UNAUTHENTICATED) throw err;
      access.refuse(key, err.detail);
    }
  }
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
    const headers = { "Content-Type": await mediaTypeOf(content), ...ifMatch(expected) };
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
    request.onerror = () => failed(new TransportError());
    request.onabort = () => failed(new DOMException("upload cancelled", "AbortError"));
    request.onload = () => {
      if (request.status < 300) done(JSON.parse(request.responseText) as Answer);
      else failed(errorOf(request.status, request.responseText, request.getResponseHeader("Retry-After")));
    };
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    request.send(content);
  });
}
