/** What the page and the worker that holds its stream say to each other. */

import type { Connection, Opened, Shown, Side, Stats } from "../types";
import type { Encoding } from "./decode";

/** Where a motion should go to at once; a greater serial is a newer wish. */
export interface Seek {
  serial: number;
  phase: number;
}

/** Everything that the characters of a side share. */
export interface Motion {
  verb: string;
  /** Empty: the verb's own. */
  method: string;
  /** Of the verb, in the order of its description. */
  names: readonly string[];
  fps: number;
  encoding: Exclude<Encoding, "weights">;
  playing: boolean;
  speed: number;
  loop: boolean;
  seek: Seek;
}

/** What the page wants to see; the worker brings the server there. */
export interface Wish {
  main: Motion;
  /** Adverbs of each character, in the order of `main.names`; the first is the one that is steered. */
  adverbs: readonly (readonly number[])[];
  /** The same verb and goal in another way, or nothing. */
  other: Motion | null;
}

export type ToWorker =
  | { kind: "start"; address: string }
  | { kind: "want"; wish: Wish }
  /** Draw at a time (ms since 1970); with arrays of earlier pictures, to be filled again. */
  | { kind: "draw"; atMs: number; spare: Float32Array[] }
  | { kind: "stop" };

export interface Drawn {
  shown: Shown;
  poses: Float32Array;
}

export type FromWorker =
  | { kind: "pictures"; pictures: Record<Side, Drawn | null> }
  | { kind: "opened"; side: Side; opened: Opened }
  | { kind: "connection"; connection: Connection; detail: string; againInS: number }
  | { kind: "stats"; stats: Stats }
  | { kind: "event"; name: string; phase: number }
  | { kind: "end" }
  | { kind: "version"; verb: string; version: number }
  | { kind: "refused"; side: Side; code: string; detail: string };
