/**
 * Holds the stream's socket, away from the page's thread: a thousand characters are decoded and interpolated here, and
 * the page gets one array per picture, without a copy. Interpolating here, and not in the page, keeps that array the
 * only thing that crosses, however many frames came in between.
 */

import { Session } from "./session";
import type { FromWorker, ToWorker } from "./worker_messages";

const SUBPROTOCOL = "adverb.v1";
const TURN_MS = 16;
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

/** ms since 1970; goes forward evenly, and is the same clock in the page and here. */
function now(): number {
  return performance.timeOrigin + performance.now();
}

function connect(): void {
  const mine = new WebSocket(address, [SUBPROTOCOL]);
  socket = mine;
  mine.binaryType = "arraybuffer";
  mine.onopen = () => session.attach((message) => mine.send(message));
  mine.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => received(mine, data);
  mine.onclose = ({ code, reason }) => lost(mine, reason || `the connection closed (${code})`);
}

function received(from: WebSocket, data: string | ArrayBuffer): void {
  if (from !== socket) return;
  const before = session.connection;
  try {
    session.receive(data, now());
  } catch (err) {
    // A server that sends what cannot be read is not one to go on with; a new connection may reach another.
    return lost(from, err instanceof Error ? err.message : String(err));
  }
  if (session.connection === "open" && before !== "open") {
    failures = 0;
    page.postMessage({ kind: "connection", connection: "open", detail: "", againInS: 0 });
  }
}

function lost(mine: WebSocket, detail: string): void {
  if (mine !== socket || stopped) return;
  socket = null;
  mine.close();
  session.lost();
  const pauseMs = Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** failures++) * (0.5 + Math.random() / 2);
  page.postMessage({ kind: "connection", connection: session.connection, detail, againInS: pauseMs / 1000 });
  setTimeout(() => stopped || connect(), pauseMs);
}

function draw(atMs: number, spare: Float32Array[]): void {
  const pictures = session.draw(atMs, spare);
  const arrays = [pictures.main, pictures.other].flatMap((drawn) => (drawn ? [drawn.poses.buffer] : []));
  page.postMessage({ kind: "pictures", pictures }, arrays);
}

function stop(): void {
  stopped = true;
  socket?.close(1000);
  page.postMessage({ kind: "connection", connection: "closed", detail: "", againInS: 0 });
  self.close();
}

function beat(): void {
  if (socket && session.silent(now(), SILENT_MS)) lost(socket, "the server does not answer any more");
  else if (session.connection === "open") session.ping(now());
}

self.onmessage = ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "start":
      address = data.address;
      connect();
      setInterval(() => session.turn(now()), TURN_MS);
      setInterval(beat, PING_MS);
      setInterval(() => page.postMessage({ kind: "stats", stats: session.stats(now()) }), STATS_MS);
      return;
    case "want":
      return session.want(data.wish);
    case "draw":
      return draw(data.atMs, data.spare);
    case "stop":
      return stop();
  }
};
