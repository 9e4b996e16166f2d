/**
 * Web worker that owns the stream's socket. It decodes and interpolates up to 1,000 characters off the main thread and
 * transfers one array per picture without a copy.
 */

import { Client, Evaluators, Link, now } from "adverb-client";
import { Session } from "./session";
import type { FromWorker, ToWorker } from "./worker_messages";

const STEP_MS = 16;
const STATS_MS = 250;

const page = self as unknown as { postMessage(message: FromWorker, transfer?: Transferable[]): void };
let address = "";
let key: string | null = null;
/** Downloads wait for a key as the stream does: without one they fail and are tried again. */
const verbs = new Evaluators({
  verbFile: (verb, options) =>
    new Client(address.replace(/^ws/, "http").replace(/\/v1\/stream$/, ""), { key }).verbFile(verb, options),
});
const session = new Session((message) => page.postMessage(message), undefined, verbs);
const link = new Link((protocols) => new WebSocket(address, protocols), session.protocol, {
  connection: (connection, detail, againInS) => page.postMessage({ kind: "connection", connection, detail, againInS }),
  unauthenticated: (key, detail) => page.postMessage({ kind: "unauthenticated", key, detail }),
});

function draw(atMs: number, spare: Float32Array[]): void {
  const pictures = session.draw(atMs, spare);
  const arrays = [pictures.main, pictures.comparison].flatMap((drawn) => (drawn ? [drawn.poses.buffer] : []));
  page.postMessage({ kind: "pictures", pictures }, arrays);
}

self.onmessage = ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "start":
      address = data.address;
      key = data.key;
      link.setKey(key);
      setInterval(() => session.step(now()), STEP_MS);
      setInterval(() => page.postMessage({ kind: "stats", stats: session.stats(now()) }), STATS_MS);
      return;
    case "key":
      key = data.key;
      return link.setKey(key);
    case "setTarget":
      return session.setTarget(data.target);
    case "draw":
      return draw(data.atMs, data.spare);
    case "stop":
      link.stop();
      self.close();
  }
};
