/** Transport bar: playback, phase slider with keytimes, pause at the goal, stream settings. */

import type { Page } from "../app";
import { BOUNDS } from "../store";
import type { Verb, View } from "../types";
import { effectorPhase } from "../verb";
import { choice, h, icon, setOptions, toggle } from "./dom";

const PLAY = "M5 3.5 12.5 8 5 12.5z";
const PAUSE = "M5.5 3.5v9M10.5 3.5v9";
const SPEEDS = [-2, -1, -0.5, 0.25, 0.5, 1, 1.5, 2];
const RATES = [10, 15, 24, 30, 60, 90, 120];

export function transport(page: Page): HTMLElement {
  return h(
    "section",
    { className: "transport", "aria-label": "Playback" },
    playButton(page),
    scrubber(page),
    h(
      "div",
      { className: "settings" },
      pauseButton(page),
      speed(page),
      loop(page),
      rate(page),
      encoding(page),
      crowdPoses(page),
    ),
  );
}

function playButton(page: Page): HTMLElement {
  const button = h("button", {
    type: "button",
    className: "play",
    onclick: () => (page.store.view.playing ? page.pause() : page.play()),
  });
  const show = () => {
    const { playing } = page.store.view;
    button.replaceChildren(icon(playing ? PAUSE : PLAY));
    button.ariaLabel = button.title = playing ? "Pause (space)" : "Play (space)";
  };
  page.store.on(["playing"], show);
  show();
  return button;
}

function scrubber(page: Page): HTMLElement {
  const range = h("input", {
    type: "range",
    min: "0",
    max: "1",
    step: "0.001",
    "aria-label": "Phase",
    oninput: () => page.seek(Number(range.value)),
  });
  const marks = h("div", { className: "marks" });
  const clock = h("output", { className: "clock", "aria-live": "off" }, "0.00 s");
  const show = (phase: number) => {
    range.value = String(phase);
    range.style.setProperty("--done", String(phase));
    range.ariaValueText = `phase ${phase.toFixed(2)}`;
  };
  show(0);
  page.on("verb", (verb) => marks.replaceChildren(...keytimeMarks(page, verb)));
  page.on("frame", ({ phase, timeS, durationS }) => {
    if (page.store.view.playing || document.activeElement !== range) show(phase);
    clock.textContent = `${timeS.toFixed(2)} / ${durationS.toFixed(2)} s`;
  });
  return h("div", { className: "scrubber" }, h("div", { className: "track" }, range, marks), clock);
}

function keytimeMarks(page: Page, verb: Verb): HTMLElement[] {
  const effector = effectorPhase(verb);
  const { keytime_phases: phases } = verb;
  const gap = (k: number) => Math.max(0, (phases[k] ?? 1) - (phases[k - 1] ?? 0));
  return phases.map((phase, k) => {
    const room = k === 0 ? gap(1) / 2 : k === phases.length - 1 ? gap(k) / 2 : Math.min(gap(k), gap(k + 1));
    const name = verb.keytime_names[k] ?? `keytime ${k + 1}`;
    return h(
      "button",
      {
        type: "button",
        className: phase === effector ? "mark effector" : "mark",
        style: `--at: ${phase}; --room: ${room}`,
        title: `Go to ${name} (phase ${phase.toFixed(2)})`,
        onclick: () => page.seek(phase),
      },
      h("span", {}, name),
    );
  });
}

/** Toggle a pause at the goal's keytime; also shows an automatic pause. */
function pauseButton(page: Page): HTMLElement {
  const button = h("button", {
    type: "button",
    className: "pause-at-goal",
    hidden: true,
    onclick: () => {
      const phase = page.verb && effectorPhase(page.verb);
      if (phase === null) return;
      if (pausedAt(page.store.view, phase)) page.play();
      else page.seek(phase);
    },
  });
  const show = () => {
    const { verb } = page;
    const phase = verb && effectorPhase(verb);
    button.hidden = phase === null;
    if (!verb || phase === null) return;
    const paused = page.pauseAtGoal.phase !== null || pausedAt(page.store.view, phase);
    button.textContent = paused ? "Paused at goal" : "Pause at goal";
    button.ariaPressed = String(paused);
    button.title =
      page.pauseAtGoal.phase === null
        ? `Pause at ${verb.measure.keytime}, where the goal is met`
        : "Playback resumes one second after the last change of the goal";
  };
  page.on("verb", show);
  page.on("pause", show);
  page.store.on(["playing", "phase"], show);
  return button;
}

function pausedAt({ playing, phase }: View, keytime: number): boolean {
  return !playing && Math.abs(phase - keytime) < 1e-3;
}

function speed(page: Page): HTMLElement {
  const options = (value: number) =>
    [...new Set([...SPEEDS, value])]
      .sort((a, b) => a - b)
      .map((step) => [String(step), `${String(step).replace("-", "−")} ×`] as const);
  const { element, select } = choice("Speed", options(1), (value) => page.store.change({ speed: Number(value) }));
  const show = () => {
    setOptions(select, options(page.store.view.speed));
    select.value = String(page.store.view.speed);
  };
  page.store.on(["speed"], show);
  show();
  return element;
}

function loop(page: Page): HTMLElement {
  const { element, box } = toggle("Loop", (on) => page.store.change({ loop: on }));
  const show = () => {
    box.checked = page.store.view.loop;
  };
  page.store.on(["loop"], show);
  show();
  return element;
}

function rate(page: Page): HTMLElement {
  const [, most] = BOUNDS.fps;
  const options = (value: number) =>
    [...new Set([...RATES, value])]
      .filter((fps) => fps <= most)
      .sort((a, b) => a - b)
      .map((fps) => [String(fps), `${fps} fps`] as const);
  const { element, select } = choice("Frame rate", options(60), (value) => page.store.change({ fps: Number(value) }));
  const show = () => {
    setOptions(select, options(page.store.view.fps));
    select.value = String(page.store.view.fps);
  };
  page.store.on(["fps"], show);
  show();
  return element;
}

function encoding(page: Page): HTMLElement {
  const options = [
    ["f32", "f32"],
    ["q48", "q48"],
    ["q32", "q32"],
  ] as const;
  const { element, select } = choice("Encoding", options, (value) => {
    page.store.change({ encoding: value === "q48" || value === "q32" ? value : "f32" });
  });
  element.title =
    "f32: full precision. q48: two fifths of the size, within 0.00015 rad. q32: one third, within 0.005 rad.";
  const show = () => {
    select.value = page.store.view.encoding;
  };
  page.store.on(["encoding"], show);
  show();
  return element;
}

function crowdPoses(page: Page): HTMLElement {
  const { element, box } = toggle("Crowd as poses", (on) => page.store.change({ crowdPoses: on }));
  element.title =
    "On: every pose of a crowd is streamed, with planted feet. Off: weights are streamed where they change, and evaluated here.";
  const show = () => {
    box.checked = page.store.view.crowdPoses;
    element.hidden = page.store.view.crowd < 2;
  };
  page.store.on(["crowdPoses", "crowd"], show);
  show();
  return element;
}
