/** Typed calls of the draft routes. */

import type { Send, SendFile } from "../api/request";
import { readMotion } from "./motion_file";
import type { DraftRest, DraftSummary } from "./types";

/** @param send fetch that throws a `Problem` */
export function draftRest(send: Send, sendFile: SendFile, base = ""): DraftRest {
  const at = (id: string) => `${base}/v1/drafts/${encodeURIComponent(id)}`;
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await send(path, init)).json();
  const body = (method: string, content: unknown, headers: Record<string, string> = {}): RequestInit => ({
    method,
    headers: { "Content-Type": "application/json", ...headers },
    body: JSON.stringify(content),
  });
  return {
    create: (zip, name, progress, signal) =>
      sendFile(`${base}/v1/drafts?${new URLSearchParams(name ? { name } : {})}`, zip, progress, signal),
    list: async () => (await json<{ drafts: DraftSummary[] }>(`${base}/v1/drafts`)).drafts,
    get: (id, signal) => json(at(id), signal ? { signal } : {}),
    motion: async (id, signal) => {
      const init: RequestInit = { headers: { Accept: "application/octet-stream" }, ...(signal && { signal }) };
      return readMotion(await (await send(`${at(id)}/motion`, init)).arrayBuffer());
    },
    change: (id, edit, revision) => json(at(id), body("PATCH", edit, { "If-Match": `"${revision}"` })),
    sequence: async (id, adverbs, fps) => {
      const init = body("POST", { adverbs, fps }, { Accept: "application/octet-stream" });
      return (await send(`${at(id)}/sequence`, init)).arrayBuffer();
    },
    publish: (id, name) => json(`${at(id)}/publish`, body("POST", name ? { name } : {})),
    remove: async (id) => void (await send(at(id), { method: "DELETE" })),
    addExample: (verb, clip, progress) =>
      sendFile(
        `${base}/v1/verbs/${encodeURIComponent(verb)}/examples?${new URLSearchParams({ file: clip.name })}`,
        clip,
        progress,
      ),
  };
}
