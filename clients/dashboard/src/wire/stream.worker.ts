/**
 * Web worker that owns the stream's socket. It decodes and interpolates up to 1,000 characters off the main thread and
 * transfers one array per picture without a copy.
 */

import { Session } from "./session";
import type { FromWorker, ToWorker } from "./worker_messages";

const SUBPROTOCOL = "adverb.v1";
const STEP_MS = 16;
const PING_MS = 1000;
const STATS_MS = 250;
const SILENT_MS = 8000;
const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 8000;

const page = self as unknown as { postMessage(message: FromWorker, transfer?: Transferable[]): void };
const session = new Session((message) => page.postMessage(message));
let address = "";
let socket: WebSocket | null = null;
let failures = 0;
let stopped = false;

/** Monotone time in ms since 1970, equal in page and worker. */
function now(): number {
  return performance.timeOrigin + performance.now();
}

function connect(): void {
  const opened = new WebSocket(address, [SUBPROTOCOL]);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.onopen = () => session.attach((message) => opened.send(message));
  opened.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => received(opened, data);
  opened.onclose = ({ code, reason }) => lost(opened, reason || `connection closed (${code})`);
}

function received(from: WebSocket, data: string | ArrayBuffer): void {
  if (from !== socket) return;
  const before = session.connection;
  try {
    session.receive(data, now());
  } catch (err) {
    // After an unreadable message, reconnect; another server may answer.
    return lost(from, err instanceof Error ? err.message : String(err));
  }
  if (session.connection === "open" && before !== "open") {
    failures = 0;
    page.postMessage({ kind: "connection", connection: "open", detail: "", againInS: 0 });
  }
}

function lost(opened: WebSocket, detail: string): void {
  if (opened !== socket || stopped) return;
  socket = null;
  opened.close();
  session.lost();
  const pauseMs = Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** failures++) * (0.5 + Math.random() / 2);
  page.postMessage({ kind: "connection", connection: session.connection, detail, againInS: pauseMs / 1000 });
  setTimeout(() => stopped || connect(), pauseMs);
}

function draw(atMs: number, spare: Float32Array[]): void {
  const pictures = session.draw(atMs, spare);
  const arrays = [pictures.main, pictures.comparison].flatMap((drawn) => (drawn ? [drawn.poses.buffer] : []));
  page.postMessage({ kind: "pictures", pictures }, arrays);
}

function stop(): void {
  stopped = true;
  socket?.close(1000);
  page.postMessage({ kind: "connection", connection: "closed", detail: "", againInS: 0 });
  self.close();
}

function heartbeat(): void {
  if (socket && session.silent(now(), SILENT_MS)) lost(socket, `no answer to a ping for ${SILENT_MS / 1000} s`);
  else if (session.connection === "open") session.ping(now());
}

self.onmessage = ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "start":
      address = data.address;
      connect();
      setInterval(() => session.step(now()), STEP_MS);
      setInterval(heartbeat, PING_MS);
      setInterval(() => page.postMessage({ kind: "stats", stats: session.stats(now()) }), STATS_MS);
      return;
    case "setTarget":
      return session.setTarget(data.target);
    case "draw":
      return draw(data.atMs, data.spare);
    case "stop":
      return stop();
  }
};
