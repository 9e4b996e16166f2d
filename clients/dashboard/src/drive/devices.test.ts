import { expect, test } from "vitest";
import { GamepadInput, keySteering, type Pad } from "./devices";

const keys = (...codes: string[]) => keySteering(new Set(codes));

test("W walks, with Shift it runs; opposite keys cancel", () => {
  expect(keys("KeyW")).toEqual({ forward: 0.5, turn: 0, side: 0 });
  expect(keys("ArrowUp", "ShiftLeft")).toEqual({ forward: 1, turn: 0, side: 0 });
  expect(keys("KeyW", "KeyS", "KeyA", "KeyE")).toEqual({ forward: 0, turn: 1, side: -1 });
});

test("the left stick of a gamepad steers, a button acts once per press", () => {
  const acted: string[] = [];
  const buttons = Array.from({ length: 6 }, () => ({ pressed: false }));
  const pad: Pad = { axes: [-1, 0], buttons };
  const input = new GamepadInput(
    () => [null, pad],
    (name) => acted.push(name),
  );
  for (const index of [0, 2, 1]) {
    buttons[index] = { pressed: true };
    input.poll();
    input.poll();
  }
  expect(acted).toEqual(["jump", "punch", "kick"]);
  buttons[0] = { pressed: false };
  input.poll();
  buttons[0] = { pressed: true };
  buttons[4] = { pressed: true };
  expect(input.poll()).toEqual({ forward: -0, turn: 1, side: 1 });
  expect(acted).toHaveLength(4);
});
