/** Messages between the page and the stream worker. */

import type { Connection, Drawn, Motion, Opened, StreamStats } from "adverb-client";
import type { Role } from "../types";

/** Requested state of the stream. */
export interface StreamTarget {
  main: Motion;
  /** Motion of all characters but the first; omitted: the same. */
  crowd?: Motion;
  /** Adverbs of each character in the order of its motion's `names`; the first is the steered one. */
  adverbs: readonly (readonly number[])[];
  /** Whether weights of the crowd are streamed and evaluated here, where its verb can be downloaded. */
  weights?: boolean;
  /** Characters that are streamed at half the frame rate, by slot. */
  distant?: readonly boolean[];
  /** Comparison with another method, or null. */
  comparison: Motion | null;
}

export type ToWorker =
  | { kind: "start"; address: string; key: string | null }
  /** Connect with this key, empty for none; null: stay disconnected until there is another. */
  | { kind: "key"; key: string | null }
  | { kind: "setTarget"; target: StreamTarget }
  /** Draw at a time (ms since 1970); earlier arrays are passed for reuse. */
  | { kind: "draw"; atMs: number; spare: Float32Array[] }
  | { kind: "stop" };

export type FromWorker =
  | { kind: "pictures"; pictures: Record<Role, Drawn | null> }
  | { kind: "opened"; role: Role; opened: Opened }
  | { kind: "connection"; connection: Connection; detail: string; againInS: number }
  /** The stream was closed because its key is not valid any more; it waits for another. */
  | { kind: "unauthenticated"; key: string; detail: string }
  | { kind: "stats"; stats: StreamStats }
  | { kind: "event"; name: string; phase: number }
  | { kind: "end" }
  | { kind: "version"; verb: string; version: number }
  | { kind: "refused"; role: Role; code: string; detail: string };
