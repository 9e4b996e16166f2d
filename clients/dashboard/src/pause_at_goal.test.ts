import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { PauseAtGoal } from "./pause_at_goal";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

test("the motion pauses during a drag and resumes one second after it", () => {
  const changed = vi.fn();
  const hold = new PauseAtGoal(changed);
  hold.move(0.5, false);
  vi.advanceTimersByTime(60_000); // the drag has not ended
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

test("a verb without a goal keytime is not paused", () => {
  const changed = vi.fn();
  new PauseAtGoal(changed).move(null, false);
  expect(changed).not.toHaveBeenCalled();
});
