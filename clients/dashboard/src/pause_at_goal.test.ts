import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { Hold } from "./pause_at_goal";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

test("held while the goal is moved, and on again a second after it was let go", () => {
  const changed = vi.fn();
  const hold = new Hold(changed);
  hold.move(0.5, false);
  vi.advanceTimersByTime(60_000); // a hand that rests on the goal still has it
  expect(hold.phase).toBe(0.5);
  hold.move(0.5, true);
  vi.advanceTimersByTime(900);
  hold.move(0.5, true);
  vi.advanceTimersByTime(900);
  expect(hold.phase).toBe(0.5);
  vi.advanceTimersByTime(200);
  expect(hold.phase).toBeNull();
  expect(changed).toHaveBeenCalledTimes(2);
});

test("a verb that meets its goal nowhere is not held", () => {
  const changed = vi.fn();
  new Hold(changed).move(null, false);
  expect(changed).not.toHaveBeenCalled();
});
