/** Transport bar of a draft: play, phase with keytimes, and what is shown. */

import { h, icon, toggle } from "../shell/dom";

const PLAY = "M5 3.5 12.5 8 5 12.5z";
const PAUSE = "M5.5 3.5v9M10.5 3.5v9";

export interface Shown {
  readonly blend: boolean;
  readonly ghosts: boolean;
  readonly paths: boolean;
}

export class Player {
  readonly element: HTMLElement;
  phase = 0;
  playing = false;
  shown: Shown = { blend: true, ghosts: true, paths: true };
  /** Seconds of one run. */
  durationS = 2;
  onChange: () => void = () => {};
  readonly #range: HTMLInputElement;
  readonly #button: HTMLButtonElement;
  readonly #marks = h("div", { className: "marks" });
  readonly #clock = h("output", { className: "clock", "aria-live": "off" });
  #request = 0;
  #last = 0;

  constructor() {
    this.#button = h("button", { type: "button", className: "play", onclick: () => this.play(!this.playing) });
    this.#range = h("input", {
      type: "range",
      min: "0",
      max: "1",
      step: "0.001",
      "aria-label": "Phase",
      oninput: () => this.seek(Number(this.#range.value)),
    });
    const flags = (["blend", "ghosts", "paths"] as const).map((key) => {
      const label = { blend: "Blend", ghosts: "All clips", paths: "Paths" }[key];
      const { element, box } = toggle(label, (on) => {
        this.shown = { ...this.shown, [key]: on };
        this.onChange();
      });
      box.checked = true;
      return element;
    });
    this.element = h(
      "section",
      { className: "transport", "aria-label": "Playback of the draft" },
      this.#button,
      h("div", { className: "scrubber" }, h("div", { className: "track" }, this.#range, this.#marks), this.#clock),
      h("div", { className: "settings" }, ...flags),
    );
    this.play(false);
    this.#show();
  }

  play(on: boolean): void {
    this.playing = on;
    this.#button.replaceChildren(icon(on ? PAUSE : PLAY));
    this.#button.ariaLabel = this.#button.title = on ? "Pause (space)" : "Play (space)";
    cancelAnimationFrame(this.#request);
    this.#last = performance.now();
    if (on) this.#request = requestAnimationFrame((now) => this.#step(now));
  }

  /** Pause at a phase. */
  seek(phase: number): void {
    this.play(false);
    this.phase = Math.min(Math.max(phase, 0), 1);
    this.#show();
    this.onChange();
  }

  /** Keytimes as marks of the slider. */
  setKeytimes(names: readonly string[], phases: readonly number[], measured: number): void {
    const gap = (k: number) => Math.max(0, (phases[k] ?? 1) - (phases[k - 1] ?? 0));
    const marks = phases.map((phase, k) => {
      const room = k === 0 ? gap(1) / 2 : k === phases.length - 1 ? gap(k) / 2 : Math.min(gap(k), gap(k + 1));
      const name = names[k] ?? `keytime ${k + 1}`;
      const className = k === measured ? "mark effector" : "mark";
      const style = `--at: ${phase}; --room: ${room}`;
      const onclick = () => this.seek(phase);
      return h("button", { type: "button", className, style, title: `Go to ${name}`, onclick }, h("span", {}, name));
    });
    this.#marks.replaceChildren(...marks);
  }

  dispose(): void {
    cancelAnimationFrame(this.#request);
    this.onChange = () => {};
  }

  #step(now: number): void {
    const step = (now - this.#last) / 1000 / Math.max(this.durationS, 0.1);
    this.#last = now;
    this.phase = (this.phase + step) % 1;
    this.#show();
    this.onChange();
    if (this.playing) this.#request = requestAnimationFrame((next) => this.#step(next));
  }

  #show(): void {
    this.#range.value = String(this.phase);
    this.#range.style.setProperty("--done", String(this.phase));
    this.#range.ariaValueText = `phase ${this.phase.toFixed(2)}`;
    this.#clock.textContent = `phase ${this.phase.toFixed(2)}`;
  }
}
