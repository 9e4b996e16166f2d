/** The page's end of the stream: says what is wanted, asks for one picture at a time. */

import type { Side } from "../types";
import type { Drawn, FromWorker, ToWorker, Wish } from "./worker_messages";

export type Heard = Exclude<FromWorker, { kind: "pictures" }>;

/** What a stream is carried by: a worker, or in tests something that takes and gives the same messages. */
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
    private readonly heard: (message: Heard) => void,
    private readonly picture: (pictures: Record<Side, Drawn | null>) => void,
  ) {
    port.onmessage = ({ data }) => this.take(data);
  }

  start(address: string): void {
    this.port.postMessage({ kind: "start", address }, []);
  }

  want(wish: Wish): void {
    this.port.postMessage({ kind: "want", wish }, []);
  }

  /** Ask for the picture of an animation frame; while one is on its way, others are left out. */
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
    if (message.kind !== "pictures") return this.heard(message);
    this.waiting = false;
    this.picture(message.pictures);
    // Shown and done with: the worker fills them again.
    for (const drawn of [message.pictures.main, message.pictures.other]) if (drawn) this.spare.push(drawn.poses);
  }
}

/** The worker of this page. */
export function openWorker(): Port {
  return new Worker(new URL("./stream.worker.ts", import.meta.url), { type: "module", name: "stream" });
}
