/** Geometry of a clip's time line: positions of keytimes, and how a handle may move. No DOM. */

/** Smallest distance between two keytimes in frames. */
const LEAST_FRAMES = 1;

/** Part of a clip that keytimes may take. */
export interface Span {
  readonly start: number;
  readonly end: number;
  readonly fps: number;
}

/** Position of a time on the line, 0 to 1. */
export function shareOf({ start, end }: Span, timeS: number): number {
  return end > start ? Math.min(Math.max((timeS - start) / (end - start), 0), 1) : 0;
}

/** Time at a position of the line in pixels. */
export function timeAt({ start, end }: Span, x: number, left: number, width: number): number {
  return start + (end - start) * Math.min(Math.max((x - left) / Math.max(width, 1), 0), 1);
}

/** Range in which keytime `k` may move: between its neighbours, one frame apart. */
export function rangeOf(span: Span, keytimes: readonly number[], k: number): readonly [number, number] {
  const gap = LEAST_FRAMES / span.fps;
  const low = k > 0 ? (keytimes[k - 1] as number) + gap : span.start;
  const high = k < keytimes.length - 1 ? (keytimes[k + 1] as number) - gap : span.end;
  return [low, Math.max(low, high)];
}

/** Keytimes with keytime `k` moved as near to `timeS` as its neighbours allow, rounded to 0.1 ms. */
export function moved(span: Span, keytimes: readonly number[], k: number, timeS: number): number[] {
  const [low, high] = rangeOf(span, keytimes, k);
  const at = Math.min(Math.max(timeS, low), high);
  const rounded = Math.min(Math.max(Math.round(1e4 * at) / 1e4, low), high);
  return keytimes.map((each, i) => (i === k ? rounded : each));
}

/** Keytimes with keytime `k` moved by whole frames of the clip. */
export function nudged(span: Span, keytimes: readonly number[], k: number, frames: number): number[] {
  return moved(span, keytimes, k, (keytimes[k] as number) + frames / span.fps);
}

/** Movement in frames of an arrow key on a handle, or null; with Shift ten frames. */
export function keyFrames(key: string, shift: boolean): number | null {
  const size = shift ? 10 : 1;
  if (key === "ArrowRight" || key === "ArrowUp") return size;
  if (key === "ArrowLeft" || key === "ArrowDown") return -size;
  if (key === "PageUp") return 10;
  return key === "PageDown" ? -10 : null;
}

/** The keytime nearest to a position of the line, and its distance as a share of the line; null without keytimes. */
export function nearest(span: Span, keytimes: readonly number[], share: number): { k: number; away: number } | null {
  const away = keytimes.map((each) => Math.abs(shareOf(span, each) - share));
  const least = Math.min(...away);
  return away.length > 0 ? { k: away.indexOf(least), away: least } : null;
}

/** Confidence in words; below 0.5 a keytime should be checked, as `adverb init` marks it. */
export function confidenceText(confidence: number | undefined): string {
  if (confidence === undefined) return "";
  const text = `confidence ${confidence.toFixed(2)}`;
  return confidence < 0.5 ? `${text}, check` : text;
}

/** Level of a confidence, for its colour. */
export function confidenceLevel(confidence: number | undefined): "high" | "middle" | "low" {
  if (confidence === undefined || confidence >= 0.8) return "high";
  return confidence < 0.5 ? "low" : "middle";
}
