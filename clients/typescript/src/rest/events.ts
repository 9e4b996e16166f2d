/** Server-sent events by fetch: `EventSource` cannot send a key. */

import { ResponseError } from "../errors.js";
import { retryMs, type Send } from "./request.js";

const RETRY_MS = 2000;

/** Data of the events in a stream, as they arrive. */
export async function* eventData(stream: ReadableStream<Uint8Array>): AsyncGenerator<string> {
  const reader = stream.pipeThrough(new TextDecoderStream() as TransformStream<Uint8Array, string>).getReader();
  let rest = "";
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      const blocks = (rest + value).split(/\r?\n\r?\n/);
      rest = blocks.pop() ?? "";
      for (const block of blocks) {
        const lines = block.split(/\r?\n/).filter((line) => line.startsWith("data:"));
        if (lines.length > 0) yield lines.map((line) => line.slice("data:".length).replace(/^ /, "")).join("\n");
      }
    }
  } finally {
    await reader.cancel().catch(() => {});
  }
}

/**
 * Follow a stream of events until `take` returns true or the returned function is called. A lost connection is opened
 * again; a refusal ends it, except for one that states when to retry.
 */
export function follow(send: Send, path: string, take: (data: string) => boolean): () => void {
  const stop = new AbortController();
  const { signal } = stop;
  const once = async (): Promise<number | null> => {
    try {
      const response = await send(path, { signal, headers: { Accept: "text/event-stream" } });
      if (response.body)
        for await (const data of eventData(response.body)) if (signal.aborted || take(data)) return null;
      return RETRY_MS;
    } catch (err) {
      const lost = !(err instanceof ResponseError) || err.retryMs > 0;
      return lost && !signal.aborted ? retryMs(err, RETRY_MS) : null;
    }
  };
  const run = async () => {
    for (;;) {
      const pauseMs = await once();
      if (pauseMs === null) return;
      await new Promise((done) => setTimeout(done, pauseMs));
      if (signal.aborted) return;
    }
  };
  void run();
  return () => stop.abort();
}
