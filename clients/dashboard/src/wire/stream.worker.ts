/**
 * Web worker that owns the stream's socket. It decodes and interpolates up to 1,000 characters off the main thread and
 * transfers one array per picture without a copy.
 */

import { Reconnector } from "./reconnector";
import { Session } from "./session";
import type { FromWorker, ToWorker } from "./worker_messages";

const STEP_MS = 16;
const PING_MS = 1000;
const STATS_MS = 250;
const SILENT_MS = 8000;

const page = self as unknown as { postMessage(message: FromWorker, transfer?: Transferable[]): void };
const session = new Session((message) => page.postMessage(message));
let address = "";
const sockets = new Reconnector((protocols) => new WebSocket(address, protocols), {
  opened: (send) => session.attach(send),
  received,
  lost: (detail, againInS) => {
    session.lost();
    page.postMessage({ kind: "connection", connection: session.connection, detail, againInS });
  },
  unauthenticated: (key, detail) => page.postMessage({ kind: "unauthenticated", key, detail }),
});

/** Monotone time in ms since 1970, equal in page and worker. */
function now(): number {
  return performance.timeOrigin + performance.now();
}

function received(data: string | ArrayBuffer): void {
  const before = session.connection;
  try {
    session.receive(data, now());
  } catch (err) {
    // After an unreadable message, reconnect; another server may answer.
    return sockets.fail(err instanceof Error ? err.message : String(err));
  }
  if (session.connection === "open" && before !== "open") {
    sockets.succeed();
    page.postMessage({ kind: "connection", connection: "open", detail: "", againInS: 0 });
  }
}

function draw(atMs: number, spare: Float32Array[]): void {
  const pictures = session.draw(atMs, spare);
  const arrays = [pictures.main, pictures.comparison].flatMap((drawn) => (drawn ? [drawn.poses.buffer] : []));
  page.postMessage({ kind: "pictures", pictures }, arrays);
}

function stop(): void {
  sockets.stop();
  page.postMessage({ kind: "connection", connection: "closed", detail: "", againInS: 0 });
  self.close();
}

function heartbeat(): void {
  if (sockets.connected && session.silent(now(), SILENT_MS))
    sockets.fail(`no answer to a ping for ${SILENT_MS / 1000} s`);
  else if (session.connection === "open") session.ping(now());
}

self.onmessage = ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "start":
      address = data.address;
      sockets.setKey(data.key);
      setInterval(() => session.step(now()), STEP_MS);
      setInterval(heartbeat, PING_MS);
      setInterval(() => page.postMessage({ kind: "stats", stats: session.stats(now()) }), STATS_MS);
      return;
    case "key":
      return sockets.setKey(data.key);
    case "setTarget":
      return session.setTarget(data.target);
    case "draw":
      return draw(data.atMs, data.spare);
    case "stop":
      return stop();
  }
};
