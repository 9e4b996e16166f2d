/** Time line of a clip: speed of the effector, keytimes as handles, and the instant that the scene shows. */

import { h } from "../shell/dom";
import {
  confidenceLevel,
  confidenceText,
  keyFrames,
  moved,
  nearest,
  nudged,
  rangeOf,
  type Span,
  shareOf,
  timeAt,
} from "./timeline";
import type { Clip } from "./types";

/** Largest distance at which a press on the line grabs a handle, as a share of the line. */
const NEAR = 0.06;

/** Full height of the curve at least: slower motion, as noise, stays low, m/s. */
const LEAST_CURVE = 0.2;

export interface LineActions {
  /** A keytime was grabbed or focused. */
  grabbed(k: number): void;
  moved(keytimes: number[]): void;
  /** A drag began or ended. */
  dragged(on: boolean): void;
}

export class ClipLine {
  readonly element: HTMLElement;
  readonly #curve = document.createElementNS("http://www.w3.org/2000/svg", "path");
  readonly #now = h("i", { className: "now" });
  readonly #handles: HTMLElement[] = [];
  #clip: Clip | null = null;
  #dragged: { k: number; pointer: number; aside: number } | null = null;

  constructor(private readonly actions: LineActions) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    svg.setAttribute("viewBox", "0 0 1 1");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("aria-hidden", "true");
    svg.append(this.#curve);
    this.element = h("div", {
      className: "clip-line",
      onpointerdown: (event) => this.#press(event),
      onpointermove: (event) => this.#drag(event),
      onpointerup: () => this.#release(),
      onpointercancel: () => this.#release(),
    });
    this.element.append(svg, this.#now);
  }

  /** @param measured index of the keytime at which the effector is measured */
  show(clip: Clip, names: readonly string[], measured: number): void {
    this.#clip = clip;
    const keytimes = clip.keytimes ?? [];
    while (this.#handles.length > keytimes.length) this.#handles.pop()?.remove();
    while (this.#handles.length < keytimes.length) this.#add(this.#handles.length);
    for (const [k, handle] of this.#handles.entries()) {
      const at = keytimes[k] as number;
      const name = names[k] ?? `keytime ${k + 1}`;
      const confidence = clip.confidence?.[k];
      const [low, high] = rangeOf(spanOf(clip), keytimes, k);
      handle.style.setProperty("--at", String(shareOf(spanOf(clip), at)));
      handle.dataset.confidence = confidenceLevel(confidence);
      handle.dataset.measured = k === measured ? "yes" : "no";
      handle.dataset.value = `${at.toFixed(3)} s`;
      handle.title = [`${name}: ${at.toFixed(3)} s`, confidenceText(confidence), clip.evidence?.[k]]
        .filter(Boolean)
        .join(", ");
      handle.ariaLabel = `${name} of ${clip.name}`;
      handle.ariaValueMin = low.toFixed(3);
      handle.ariaValueMax = high.toFixed(3);
      handle.ariaValueNow = at.toFixed(3);
      handle.ariaValueText = [`${at.toFixed(3)} seconds`, confidenceText(confidence)].filter(Boolean).join(", ");
    }
  }

  /** Mark the displayed instant, s; null hides the mark. */
  showTime(timeS: number | null): void {
    this.#now.hidden = timeS === null || !this.#clip;
    if (timeS !== null && this.#clip) this.#now.style.setProperty("--at", String(shareOf(spanOf(this.#clip), timeS)));
  }

  /** Draw a curve of values at uniform instants, as the effector's speed. */
  showCurve(values: readonly number[]): void {
    const most = Math.max(...values, LEAST_CURVE);
    const points = values.map(
      (value, k) => `L${(k / Math.max(values.length - 1, 1)).toFixed(4)} ${(1 - value / most).toFixed(3)}`,
    );
    this.#curve.setAttribute("d", values.length > 1 ? `M0 1${points.join("")}L1 1Z` : "");
  }

  #add(k: number): void {
    const handle = h("button", {
      type: "button",
      role: "slider",
      className: "keytime",
      onfocus: () => this.actions.grabbed(k),
      onkeydown: (event) => this.#key(event, k),
    });
    this.#handles.push(handle);
    this.element.append(handle);
  }

  #key(event: KeyboardEvent, k: number): void {
    const clip = this.#clip;
    const frames = keyFrames(event.key, event.shiftKey);
    if (!clip?.keytimes) return;
    const [low, high] = rangeOf(spanOf(clip), clip.keytimes, k);
    const end = event.key === "Home" ? low : event.key === "End" ? high : null;
    if (frames === null && end === null) return;
    event.preventDefault();
    event.stopPropagation();
    const next =
      frames === null
        ? moved(spanOf(clip), clip.keytimes, k, end as number)
        : nudged(spanOf(clip), clip.keytimes, k, frames);
    this.actions.grabbed(k);
    this.actions.moved(next);
  }

  #press(event: PointerEvent): void {
    const clip = this.#clip;
    if (!clip?.keytimes || event.button !== 0 || this.#dragged) return;
    const { left, width } = this.element.getBoundingClientRect();
    const share = (event.clientX - left) / Math.max(width, 1);
    const own = this.#handles.indexOf(event.target as HTMLElement);
    const near = own >= 0 ? { k: own, away: 0 } : nearest(spanOf(clip), clip.keytimes, share);
    if (!near || near.away > NEAR) return;
    event.preventDefault();
    const aside = left + width * shareOf(spanOf(clip), clip.keytimes[near.k] as number) - event.clientX;
    this.#dragged = { k: near.k, pointer: event.pointerId, aside };
    this.element.setPointerCapture(event.pointerId);
    this.#handles[near.k]?.focus({ preventScroll: true });
    this.#handles[near.k]?.classList.add("dragged");
    this.actions.dragged(true);
    this.actions.grabbed(near.k);
  }

  #drag(event: PointerEvent): void {
    const [clip, drag] = [this.#clip, this.#dragged];
    if (!clip?.keytimes || !drag || event.pointerId !== drag.pointer) return;
    const { left, width } = this.element.getBoundingClientRect();
    const next = moved(
      spanOf(clip),
      clip.keytimes,
      drag.k,
      timeAt(spanOf(clip), event.clientX + drag.aside, left, width),
    );
    if (next[drag.k] !== clip.keytimes[drag.k]) this.actions.moved(next);
  }

  #release(): void {
    if (!this.#dragged) return;
    this.#handles[this.#dragged.k]?.classList.remove("dragged");
    this.#dragged = null;
    this.actions.dragged(false);
  }
}

export function spanOf({ start, end, fps }: Clip): Span {
  return { start: start ?? 0, end: end ?? 0, fps: fps ?? 30 };
}
