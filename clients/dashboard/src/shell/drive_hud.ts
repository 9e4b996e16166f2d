/** Drive mode's part of the scene: speed, foot slide, keys, and on touch screens a stick and buttons. */

import type { Page } from "../app";
import { ACTIONS, type ActionName } from "../drive/actions";
import { STILL, stick } from "../drive/steering";
import type { Drawn } from "../types";
import { slideText } from "../units";
import { h } from "./dom";

const EVERY_MS = 100;
const KEYS: Readonly<Record<ActionName, string>> = { jump: "Space", punch: "J", kick: "K" };
const LABELS: Readonly<Record<ActionName, string>> = { jump: "Jump", punch: "Punch", kick: "Kick" };
const MOVES = [
  [["W", "S"], "forward, back"],
  [["A", "D"], "turn"],
  [["Q", "E"], "side-step"],
  [["Shift"], "run"],
] as const;

export function driveHud(page: Page, drawn: () => Drawn | null): HTMLElement {
  return h(
    "div",
    { className: "drive-hud" },
    values(page, drawn),
    hints(page),
    pad(page),
    buttons(page, "touch-buttons"),
  );
}

/** Requested velocity, the displayed verb, and the slide of the standing feet. */
function values(page: Page, drawn: () => Drawn | null): HTMLElement {
  const speed = h("output", { className: "error", "aria-live": "off" }, "0.0 m/s");
  const turn = h("dd", {}, "0 °/s");
  const verb = h("dd", {}, "–");
  const title = "Largest horizontal movement of a foot that stands, since it landed";
  const slide = h("dd", { title }, "–");
  let dueMs = 0;
  page.on("frame", (shown) => {
    if (!page.drive.active || performance.now() < dueMs) return;
    dueMs = performance.now() + EVERY_MS;
    speed.textContent = `${Math.hypot(...page.drive.velocity()).toFixed(1)} m/s`;
    turn.textContent = `${Math.round((page.drive.turnRate() * 180) / Math.PI)} °/s`.replace("-", "−");
    verb.textContent = shown.verb;
    slide.textContent = slideText(drawn()?.slide ?? null);
  });
  return h(
    "section",
    { className: "readout driven", "aria-label": "Drive" },
    h("div", { className: "figure" }, speed, h("span", { className: "caption" }, "requested speed")),
    h(
      "dl",
      { className: "facts" },
      ...[h("dt", {}, "Turn rate"), turn, h("dt", {}, "Verb"), verb],
      ...[h("dt", { title }, "Foot slide"), slide],
    ),
  );
}

function hints(page: Page): HTMLElement {
  const moves = MOVES.map(([keys, meaning]) =>
    h("span", { className: "hint" }, ...keys.map((key) => h("kbd", {}, key)), meaning),
  );
  const gamepad = h("span", { className: "hint", hidden: true }, "Gamepad: left stick, A jump, X punch, B kick");
  page.on("frame", () => {
    gamepad.hidden = !page.drive.gamepad.connected;
  });
  return h(
    "section",
    { className: "drive-hints", "aria-label": "Keys" },
    ...moves,
    buttons(page, "action-buttons"),
    gamepad,
  );
}

/** One button for each action that the verb can switch to. */
function buttons(page: Page, className: string): HTMLElement {
  const all = ACTIONS.map((name) => {
    const act = () => page.drive.act(name);
    const keys = { title: `${LABELS[name]} (${KEYS[name]})`, "aria-keyshortcuts": KEYS[name] };
    const button = h("button", { type: "button", ...keys, onclick: act }, h("kbd", {}, KEYS[name]), LABELS[name]);
    return [name, button] as const;
  });
  const element = h("div", { className }, ...all.map(([, button]) => button));
  const show = () => {
    for (const [name, button] of all) button.hidden = !page.drive.has(name);
  };
  page.on("actions", show);
  show();
  return element;
}

/** Stick for a thumb: up walks and at the rim runs, sideways turns. */
function pad(page: Page): HTMLElement {
  const knob = h("div", { className: "knob" });
  const element = h("div", { className: "stick", role: "img", "aria-label": "Stick: drag to steer" }, knob);
  const put = (x: number, y: number) => {
    knob.style.translate = `${50 * x}% ${50 * y}%`;
    const [across, down] = stick(x, y);
    page.drive.touch = x === 0 && y === 0 ? STILL : { forward: -down, turn: -across, side: 0 };
  };
  const move = (event: PointerEvent) => {
    const { left, top, width, height } = element.getBoundingClientRect();
    const [x, y] = [(2 * (event.clientX - left)) / width - 1, (2 * (event.clientY - top)) / height - 1];
    const size = Math.max(Math.hypot(x, y), 1);
    put(x / size, y / size);
  };
  element.onpointerdown = (event) => {
    element.setPointerCapture(event.pointerId);
    move(event);
  };
  element.onpointermove = (event) => element.hasPointerCapture(event.pointerId) && move(event);
  element.onpointerup = element.onpointercancel = () => put(0, 0);
  return element;
}
