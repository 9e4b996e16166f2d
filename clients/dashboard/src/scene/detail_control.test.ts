import { expect, test } from "vitest";
import { DetailControl, distantOf, LEVELS } from "./detail_control";

/** Run for some seconds on a machine whose frames take a time by level; returns the levels at each change. */
function run(control: DetailControl, seconds: number, costMs: (level: number) => number): number[] {
  const changes: number[] = [];
  for (let spent = 0; spent < 1000 * seconds; ) {
    const intervalMs = Math.max(1000 / 60, costMs(control.level));
    spent += intervalMs;
    if (control.frame(intervalMs)) changes.push(control.level);
  }
  return changes;
}

test("a fast machine keeps full detail, also on a display of 50 Hz", () => {
  expect(run(new DetailControl(), 60, () => 20)).toEqual([]);
  expect(run(new DetailControl(), 60, () => 5)).toEqual([]);
});

test("detail is lowered before the rate falls below 45, until it is high enough", () => {
  const control = new DetailControl();
  expect(run(control, 4, (level) => (level < 2 ? 22 : 12))).toEqual([1, 2]);
  expect(run(new DetailControl(), 5, () => 40)).toEqual([1, 2, 3, LEVELS.sparse]);
  expect(run(new DetailControl(), 5, () => 400)).toEqual([2, LEVELS.sparse]);
});

test("detail is raised after a time without load", () => {
  const control = new DetailControl();
  run(control, 5, () => 40);
  expect(run(control, 30, () => 5)).toEqual([3, 2, 1, 0]);
});

test("a level that is too much is tried less and less often", () => {
  const control = new DetailControl();
  const tries = (seconds: number) =>
    run(control, seconds, (level) => (level < 1 ? 30 : 10)).filter((level) => level === 0);
  const [first, second] = [tries(60).length, tries(60).length];
  expect(first).toBeGreaterThan(1);
  expect(second).toBeLessThan(first);
});

test("pauses of a hidden page do not count", () => {
  const control = new DetailControl();
  for (let k = 0; k < 20; k++) control.frame(6000);
  expect(control.level).toBe(0);
});

test("the further half of a crowd is distant, but never its first character", () => {
  const places = Float32Array.from([9, 1, 2, 3, 4, 5].flatMap((x) => [x, 0, 0]));
  expect(distantOf(places, 6, 0, 0)).toEqual([false, false, false, false, false, true]);
  expect(distantOf(places, 6, 9, 0)).toEqual([false, true, true, false, false, false]);
});
