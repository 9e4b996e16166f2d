/** Input devices: keyboard and gamepad. */

import type { ActionName } from "./actions";
import { STILL, type Steering, stick } from "./steering";

/** Physical keys, so that other layouts have the same positions. */
const KEYS: Readonly<Record<string, keyof typeof HELD>> = {
  ...{ KeyW: "ahead", ArrowUp: "ahead", KeyS: "back", ArrowDown: "back" },
  ...{ KeyA: "left", ArrowLeft: "left", KeyD: "right", ArrowRight: "right" },
  ...{ KeyQ: "sideLeft", KeyE: "sideRight", ShiftLeft: "run", ShiftRight: "run" },
};
const HELD = { ahead: 0, back: 0, left: 0, right: 0, sideLeft: 0, sideRight: 0, run: 0 };
const ACTION_KEYS: Readonly<Record<string, ActionName>> = { Space: "jump", KeyJ: "punch", KeyK: "kick" };

/** Elements with own keyboard input, and those with own keys for the space bar and the arrows. */
const TYPING = "input[type=number], input[type=text], input[type=search], select, textarea, dialog";
const PRESSED = "button, [type=checkbox], summary, a";
const MOVED = "[role=tablist], input[type=range]";

/** Buttons of a standard gamepad: A, X, B, and the shoulders. */
const PAD: readonly (readonly [number, ActionName])[] = [
  [0, "jump"],
  [2, "punch"],
  [1, "kick"],
];
const [SHOULDER_LEFT, SHOULDER_RIGHT] = [4, 5];

/** Steering by the codes of the pressed keys. */
export function keySteering(codes: ReadonlySet<string>): Steering {
  const held = { ...HELD };
  for (const code of codes) {
    const meaning = KEYS[code];
    if (meaning) held[meaning] = 1;
  }
  const { ahead, back, left, right, sideLeft, sideRight, run } = held;
  return { forward: (ahead - back) * (run ? 1 : 0.5), turn: left - right, side: sideLeft - sideRight };
}

export class Keyboard {
  private readonly codes = new Set<string>();

  /** @param enabled whether the keys steer now; @param act called once for each press of an action's key */
  constructor(
    private readonly enabled: () => boolean,
    private readonly act: (name: ActionName) => void,
  ) {}

  get steering(): Steering {
    return this.codes.size > 0 ? keySteering(this.codes) : STILL;
  }

  /** Receives the keys before the page's shortcuts do. */
  listen(target: Window): void {
    target.addEventListener("keydown", (event) => this.down(event), true);
    target.addEventListener("keyup", ({ code }) => this.codes.delete(code), true);
    target.addEventListener("blur", () => this.codes.clear());
  }

  private down(event: KeyboardEvent): void {
    const { code, repeat } = event;
    if (!this.enabled() || event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target instanceof Element ? event.target : document.body;
    if (target.closest(TYPING) || (code.startsWith("Arrow") && target.closest(MOVED))) return;
    const action = ACTION_KEYS[code];
    if (code === "Space" && target.closest(PRESSED)) return;
    if (action && !repeat) this.act(action);
    if (KEYS[code]) this.codes.add(code);
    if (!action && !KEYS[code]) return;
    if (!code.startsWith("Shift")) event.preventDefault();
    event.stopImmediatePropagation();
  }
}

/** The part of a `Gamepad` that is read. */
export interface Pad {
  readonly axes: readonly number[];
  readonly buttons: readonly { readonly pressed: boolean }[];
}

export class GamepadInput {
  connected = false;
  private pressed = new Set<ActionName>();

  constructor(
    private readonly pads: () => readonly (Pad | null)[],
    private readonly act: (name: ActionName) => void,
  ) {}

  /** Read the first gamepad; call once per animation frame. */
  poll(): Steering {
    const pad = this.pads().find((one) => one !== null);
    this.connected = pad !== undefined;
    if (!pad) return STILL;
    const down = (index: number) => pad.buttons[index]?.pressed === true;
    for (const [index, name] of PAD) {
      if (down(index) && !this.pressed.has(name)) this.act(name);
      if (down(index)) this.pressed.add(name);
      else this.pressed.delete(name);
    }
    const [x, y] = stick(pad.axes[0] ?? 0, pad.axes[1] ?? 0);
    return { forward: -y, turn: -x, side: Number(down(SHOULDER_LEFT)) - Number(down(SHOULDER_RIGHT)) };
  }
}

/** Gamepads of the browser; none where they are unavailable. */
export function browserPads(): readonly (Pad | null)[] {
  try {
    return navigator.getGamepads?.() ?? [];
  } catch {
    return []; // not allowed in this frame
  }
}
