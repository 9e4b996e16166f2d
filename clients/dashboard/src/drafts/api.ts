/** Typed calls of the draft routes. */

import { ifMatch, jsonBody, type Send } from "adverb-client";
import type { SendFile } from "../api/request";
import { readMotion } from "./motion_file";
import type { DraftRest, DraftSummary } from "./types";

/** @param send fetch that throws a `AdverbError` */
export function draftRest(send: Send, sendFile: SendFile, base = ""): DraftRest {
  const at = (id: string) => `${base}/v1/drafts/${encodeURIComponent(id)}`;
  const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await send(path, init)).json();
  return {
    create: (zip, name, progress, signal) =>
      sendFile(`${base}/v1/drafts?${new URLSearchParams(name ? { name } : {})}`, zip, progress, signal),
    list: async () => (await json<{ drafts: DraftSummary[] }>(`${base}/v1/drafts`)).drafts,
    get: (id, signal) => json(at(id), signal ? { signal } : {}),
    motion: async (id, signal) => {
      const init: RequestInit = { headers: { Accept: "application/octet-stream" }, ...(signal && { signal }) };
      return readMotion(await (await send(`${at(id)}/motion`, init)).arrayBuffer());
    },
    change: (id, edit, revision) => json(at(id), jsonBody("PATCH", edit, ifMatch(revision))),
    sequence: async (id, adverbs, fps) => {
      const init = jsonBody("POST", { adverbs, fps }, { Accept: "application/octet-stream" });
      return (await send(`${at(id)}/sequence`, init)).arrayBuffer();
    },
    publish: (id, name) => json(`${at(id)}/publish`, jsonBody("POST", name ? { name } : {})),
    remove: async (id) => void (await send(at(id), { method: "DELETE" })),
    addExample: (verb, clip, progress) =>
      sendFile(
        `${base}/v1/verbs/${encodeURIComponent(verb)}/examples?${new URLSearchParams({ file: clip.name })}`,
        clip,
        progress,
      ),
  };
}
