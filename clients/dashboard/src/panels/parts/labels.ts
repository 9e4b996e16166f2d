/** Texts about refinements and versions. */

import type { Caller } from "../../access/access";
import type { Change, Refinement, Version } from "../../types";
import { digits } from "../../units";

/** Progress of a refinement; missing fields get defaults. */
export interface RefinementProgress {
  ratio: number;
  pseudo: number;
  error_max: number | null;
  /** Mean cost of the motions, in a refinement for quality. */
  cost_mean: number | null;
  stopped: string;
  note: string;
  /**
   * Pseudo-examples, then mean and largest error relative to the diagonal of the goal range; for quality, mean and 95th
   * percentile of the cost.
   */
  curve: readonly (readonly [number, number, number])[];
}

export function progressOf({ progress }: Refinement): RefinementProgress {
  const known = progress as Partial<RefinementProgress>;
  const { ratio = 0, pseudo = 0, error_max = null, cost_mean = null, stopped = "", note = "", curve = [] } = known;
  return { ratio, pseudo, error_max, cost_mean, stopped, note, curve };
}

export function running({ state }: Refinement): boolean {
  return state === "queued" || state === "running";
}

/** State of a refinement in one line. */
export function stateText(refinement: Refinement): string {
  const { state, detail, version_before, version_after } = refinement;
  switch (state) {
    case "queued":
      return "Waiting for a worker";
    case "running":
      return runningText(progressOf(refinement));
    case "published":
      if (version_after === null) return "Published";
      return notActivated(refinement)
        ? `Kept as version ${version_after}, not activated`
        : `Published as version ${version_after}`;
    case "not_better":
      return version_before === null ? "No improvement" : `No improvement; version ${version_before} stays`;
    case "failed":
      return withDetail("Failed", detail);
    case "given_up":
      return withDetail("Abandoned", detail);
    case "cancelled":
      return "Cancelled";
  }
}

function runningText({ pseudo, error_max, cost_mean, stopped }: RefinementProgress): string {
  if (stopped) return `${capitalised(stopped)}; comparing with the current version`;
  const error = error_max === null ? "" : `, largest error ${percent(error_max)}`;
  const cost = cost_mean === null ? "" : `, mean cost ${digits(cost_mean)}`;
  return `${pseudo} pseudo-example${pseudo === 1 ? "" : "s"}${error}${cost}`;
}

function withDetail(label: string, detail: string): string {
  return detail ? `${label}: ${detail}` : label;
}

function capitalised(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Whether another version became current while the refinement ran, so that its version was not activated. */
function notActivated({ state, detail }: Refinement): boolean {
  return state === "published" && detail.startsWith("kept as version");
}

/** Measured reason of a refinement without improvement or activation, shown in its details. */
export function detailText(refinement: Refinement): string {
  const { state, detail } = refinement;
  if (notActivated(refinement)) return detail;
  return state === "not_better" ? detail.replace(/^(not better|no improvement):\s*/i, "") : "";
}

/** Percentage with two significant digits. */
export function percent(share: number): string {
  return `${Number((100 * share).toPrecision(2))} %`;
}

const STEPS: readonly (readonly [seconds: number, name: string])[] = [
  [86_400, "day"],
  [3_600, "hour"],
  [60, "minute"],
];

/** Approximate age. */
export function ageText(secondsAgo: number): string {
  for (const [length, name] of STEPS) {
    const count = Math.floor(secondsAgo / length);
    if (count > 0) return `${count} ${name}${count === 1 ? "" : "s"} ago`;
  }
  return "just now";
}

/** Quality of a version by one method. */
export interface QualityRow {
  method: string;
  mean: number;
  max: number;
  /** null if not measured. */
  kappa: number | null;
}

interface MeasuredQuality {
  method: string;
  error_mean_m: number;
  error_max_m: number;
  smoothness: number;
}

/** Quality rows of a version: one for a refined version, one per method for a built version. */
export function qualityRows({ quality }: Version): QualityRow[] {
  const measured = quality.new as MeasuredQuality | undefined;
  if (measured) {
    const { method, error_mean_m, error_max_m, smoothness } = measured;
    return [{ method, mean: error_mean_m, max: error_max_m, kappa: smoothness }];
  }
  const methods = (quality.methods ?? {}) as Record<string, Partial<MeasuredQuality>>;
  return Object.entries(methods).map(([method, row]) => ({
    method,
    mean: row.error_mean_m ?? Number.NaN,
    max: row.error_max_m ?? Number.NaN,
    kappa: row.smoothness ?? null,
  }));
}

/** Author and parent of a version. */
export function authorText({ author, parent }: Version): string {
  const name = author.startsWith("job ") ? "refinement" : author;
  return parent === null ? name : `${name} of version ${parent}`;
}

/** Name, scopes and end of a key. */
export function callerText({ required, id, name, scopes, expires_at }: Caller): string {
  if (!required) return "This server needs no key.";
  const end = expires_at === null ? "does not expire" : `expires ${new Date(1000 * expires_at).toLocaleString()}`;
  return `${name || id} · ${scopes.join(", ") || "no scopes"} · ${end}`;
}

const CHANGES: Record<string, (change: Change) => string> = {
  publish: ({ verb, number }) => `Published ${verb}\u00a0v${number}`,
  activate: ({ verb, number }) => `Activated ${verb}\u00a0v${number}`,
  delete: ({ verb, number }) => `Deleted ${verb}, which had v${number}`,
  refine: ({ verb, number }) => `Started a refinement of ${verb}\u00a0v${number}`,
  cancel: ({ verb, number }) => `Cancelled a refinement of ${verb}\u00a0v${number}`,
};

export function changeText(change: Change): string {
  return CHANGES[change.kind]?.(change) ?? `${change.kind}: ${change.verb} v${change.number}`;
}
