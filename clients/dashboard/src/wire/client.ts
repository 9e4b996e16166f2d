/** The page's interface to the stream worker; at most one picture is in flight. */

import type { Drawn } from "adverb-client";
import type { Role } from "../types";
import type { FromWorker, StreamTarget, ToWorker } from "./worker_messages";

export type StreamEvent = Exclude<FromWorker, { kind: "pictures" }>;

/** Message port of the worker; replaced in tests. */
export interface Port {
  postMessage(message: ToWorker, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<FromWorker>) => void) | null;
  terminate(): void;
}

export class StreamClient {
  private waiting = false;
  private spare: Float32Array[] = [];

  constructor(
    private readonly port: Port,
    private readonly onEvent: (message: StreamEvent) => void,
    private readonly onPictures: (pictures: Record<Role, Drawn | null>) => void,
  ) {
    port.onmessage = ({ data }) => this.take(data);
  }

  start(address: string, key: string | null): void {
    this.port.postMessage({ kind: "start", address, key }, []);
  }

  /** Connect with another key; null: disconnect until there is one. */
  setKey(key: string | null): void {
    this.port.postMessage({ kind: "key", key }, []);
  }

  setTarget(target: StreamTarget): void {
    this.port.postMessage({ kind: "setTarget", target }, []);
  }

  /** Request a picture for an animation frame unless one is in flight. */
  draw(frameMs: number): void {
    if (this.waiting) return;
    this.waiting = true;
    const spare = this.spare.splice(0);
    const message: ToWorker = { kind: "draw", atMs: performance.timeOrigin + frameMs, spare };
    this.port.postMessage(
      message,
      spare.map((array) => array.buffer),
    );
  }

  stop(): void {
    this.port.postMessage({ kind: "stop" }, []);
  }

  private take(message: FromWorker): void {
    if (message.kind !== "pictures") return this.onEvent(message);
    this.waiting = false;
    this.onPictures(message.pictures);
    // the worker refills the arrays
    for (const drawn of [message.pictures.main, message.pictures.comparison]) if (drawn) this.spare.push(drawn.poses);
  }
}

/** Start the stream worker. */
export function openWorker(): Port {
  return new Worker(new URL("./stream.worker.ts", import.meta.url), { type: "module", name: "stream" });
}
