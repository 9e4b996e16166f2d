/** What a character of a stream does, and what is displayed of it. */

import type { Encoding } from "../wire/decode.js";

/** Seek request; a greater serial is newer. */
export interface Seek {
  serial: number;
  phase: number;
}

/** Requested motion of a channel. */
export interface Motion {
  verb: string;
  /** Empty: the verb's default. */
  method: string;
  /** Adverb names in the verb's order. */
  names: readonly string[];
  fps: number;
  /** `weights`: records where they differ only; phases advance and poses are evaluated here. */
  encoding: Encoding;
  playing: boolean;
  speed: number;
  /** Omitted: the verb's own. */
  loop?: boolean;
  seek: Seek;
  /** Time in which half of the distance to a goal is covered, s; omitted: the server's default. */
  halfLife?: number;
  /** Change the verb by `switch`, which keeps position and heading; otherwise the channel is opened again. */
  switches?: boolean;
  /** Serial of the last `switch`; another one is sent also where the verb is the same. */
  switchSerial?: number;
  /** Duration of the transition of a `switch`, s; omitted: the server chooses. */
  transitionS?: number;
  /** Further fields of `open`, such as `joints`, `plant` and `priority`; they count when the channel is opened. */
  options?: Readonly<Record<string, unknown>>;
}

/** Displayed state of a figure's first character. */
export interface Shown {
  verb: string;
  version: number;
  method: string;
  phase: number;
  timeS: number;
  durationS: number;
  /** In the unit of the verb's measure (m, m/s); NaN if not measured. */
  error: number;
  /** How well the examples support the pose, 0 to 1; null unless `support` is requested. */
  support: number | null;
  clamped: boolean;
  inTransition: boolean;
  /** x, y, z, metres. */
  root: readonly [number, number, number];
  /** Number of characters. */
  count: number;
}

/** Displayed poses of a figure's characters. */
export interface Drawn {
  shown: Shown;
  /** count × (3 + 4·joints): root x, y, z, then x, y, z, w per joint. */
  poses: Float32Array;
}
