/** Rates and quantiles of the server's metrics between two scrapes. */

import { type Buckets, buckets, mean, parse, quantile, since, total } from "./prometheus";

/** Counters and gauges of one scrape. */
export interface Scrape {
  atS: number;
  requests: Buckets;
  frameLateness: Buckets;
  loopLateness: Buckets;
  frames: number;
  dropped: number;
  poses: number;
  streams: number;
  characters: number;
  /** Error histograms by verb. */
  errors: ReadonlyMap<string, Buckets>;
}

/** Seconds, counts per second, metres; NaN without data. */
export interface ServerMetrics {
  atS: number;
  requests: Quantiles;
  frameLateness: Quantiles;
  loopLateness: Quantiles;
  framesPerS: number;
  droppedPerS: number;
  posesPerS: number;
  streams: number;
  characters: number;
  errors: ReadonlyMap<string, number>;
}

export type Quantiles = readonly [p50: number, p95: number, p99: number];

const NAMES = [
  "adverb_request_duration_seconds",
  "adverb_stream_lateness_seconds",
  "adverb_event_loop_lateness_seconds",
  "adverb_pose_error_meters",
  "adverb_stream_frames",
  "adverb_poses_total",
  "adverb_streams",
  "adverb_channels",
] as const;

/** Excludes event streams, whose duration is not a latency. */
function quick({ route = "" }: Readonly<Record<string, string>>): boolean {
  return route.startsWith("/v1/") && !route.endsWith("/events");
}

export function scrapeOf(text: string, atS: number): Scrape {
  const samples = parse(text, (name) => NAMES.some((known) => name.startsWith(known)));
  const verbs = new Set(
    samples.flatMap(({ name, labels }) => (name === "adverb_pose_error_meters_sum" ? (labels.verb ?? []) : [])),
  );
  const count = (name: string) => total(samples, name) || 0;
  return {
    atS,
    requests: buckets(samples, "adverb_request_duration_seconds", quick),
    frameLateness: buckets(samples, "adverb_stream_lateness_seconds"),
    loopLateness: buckets(samples, "adverb_event_loop_lateness_seconds"),
    frames: count("adverb_stream_frames_total"),
    dropped: count("adverb_stream_frames_dropped_total"),
    poses: count("adverb_poses_total"),
    streams: count("adverb_streams"),
    characters: count("adverb_channels"),
    errors: new Map(
      [...verbs]
        .sort()
        .map((verb) => [verb, buckets(samples, "adverb_pose_error_meters", (labels) => labels.verb === verb)]),
    ),
  };
}

export function between(before: Scrape, now: Scrape): ServerMetrics {
  const seconds = now.atS - before.atS;
  const rate = (key: "frames" | "dropped" | "poses") => Math.max(now[key] - before[key], 0) / seconds;
  const late = (key: "requests" | "frameLateness" | "loopLateness") => quantiles(since(now[key], before[key]));
  const none: Buckets = { bounds: [], counts: [], sum: 0 };
  return {
    atS: now.atS,
    requests: late("requests"),
    frameLateness: late("frameLateness"),
    loopLateness: late("loopLateness"),
    framesPerS: rate("frames"),
    droppedPerS: rate("dropped"),
    posesPerS: rate("poses"),
    streams: now.streams,
    characters: now.characters,
    errors: new Map([...now.errors].map(([verb, all]) => [verb, mean(since(all, before.errors.get(verb) ?? none))])),
  };
}

function quantiles(of: Buckets): Quantiles {
  return [quantile(of, 0.5), quantile(of, 0.95), quantile(of, 0.99)];
}
