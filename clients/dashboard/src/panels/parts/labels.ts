/** What the server knows, in plain words. */

import type { Refinement, Version } from "../../types";

/** What a refinement tells of its course; fields are missing before it has begun. */
export interface Course {
  ratio: number;
  pseudo: number;
  error_max: number | null;
  stopped: string;
  note: string;
  /** Pseudo-examples, mean and largest error as shares of the goals' diagonal. */
  curve: readonly (readonly [number, number, number])[];
}

export function courseOf({ progress }: Refinement): Course {
  const told = progress as Partial<Course>;
  const { ratio = 0, pseudo = 0, error_max = null, stopped = "", note = "", curve = [] } = told;
  return { ratio, pseudo, error_max, stopped, note, curve };
}

export function running({ state }: Refinement): boolean {
  return state === "queued" || state === "running";
}

/** How a refinement is, or how it ended. */
export function stateText(refinement: Refinement): string {
  const { state, detail, version_after } = refinement;
  switch (state) {
    case "queued":
      return "waiting for a worker";
    case "running":
      return runningText(courseOf(refinement));
    case "published":
      return version_after === null ? "published" : `published as version ${version_after}`;
    case "not_better":
      return prefixed("not better", detail);
    case "failed":
      return prefixed("failed", detail);
    case "given_up":
      return prefixed("given up", detail);
    case "cancelled":
      return "cancelled";
  }
}

function runningText({ pseudo, error_max, stopped }: Course): string {
  if (stopped) return `${stopped}; comparing it with the version that is served`;
  const error = error_max === null ? "" : `, error at most ${percent(error_max)}`;
  return `${pseudo} pseudo-example${pseudo === 1 ? "" : "s"}${error}`;
}

function prefixed(prefix: string, detail: string): string {
  if (!detail) return prefix;
  return detail.startsWith(prefix) ? detail : `${prefix}: ${detail}`;
}

/** A share as per cent, with two digits that say something. */
export function percent(share: number): string {
  return `${Number((100 * share).toPrecision(2))} %`;
}

const STEPS: readonly (readonly [seconds: number, name: string])[] = [
  [86_400, "day"],
  [3_600, "hour"],
  [60, "minute"],
];

/** How long ago, roughly. */
export function ago(secondsAgo: number): string {
  for (const [length, name] of STEPS) {
    const count = Math.floor(secondsAgo / length);
    if (count > 0) return `${count} ${name}${count === 1 ? "" : "s"} ago`;
  }
  return "just now";
}

/** What was measured of a version by one method. */
export interface Figures {
  method: string;
  mean: number;
  max: number;
  /** null where it was not measured. */
  kappa: number | null;
}

interface Judged {
  method: string;
  error_mean_m: number;
  error_max_m: number;
  smoothness: number;
}

/** A version's quality: of a refined one as it was judged, of a built one as it was measured by each method. */
export function figuresOf({ quality }: Version): Figures[] {
  const judged = quality.new as Judged | undefined;
  if (judged) {
    const { method, error_mean_m, error_max_m, smoothness } = judged;
    return [{ method, mean: error_mean_m, max: error_max_m, kappa: smoothness }];
  }
  const methods = (quality.methods ?? {}) as Record<string, Partial<Judged>>;
  return Object.entries(methods).map(([method, told]) => ({
    method,
    mean: told.error_mean_m ?? Number.NaN,
    max: told.error_max_m ?? Number.NaN,
    kappa: told.smoothness ?? null,
  }));
}

/** Who made a version, and from which. */
export function makerText({ who, parent }: Version): string {
  const maker = who.startsWith("job ") ? "a refinement" : who;
  return parent === null ? maker : `${maker} of version ${parent}`;
}
