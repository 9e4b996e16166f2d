import fc from "fast-check";
import { expect, test } from "vitest";
import { Clock, Lateness } from "./clock.js";

test("the offset error is at most half the least round trip", () => {
  const delay = fc.double({ min: 0, max: 400, noNaN: true });
  fc.assert(
    fc.property(fc.array(fc.tuple(delay, delay), { minLength: 1, maxLength: 50 }), (pings) => {
      const clock = new Clock();
      const offset = 12_345.678;
      pings.forEach(([out, back], k) => {
        const sent = 1000 * k;
        clock.add(sent, sent + out + back, sent + out + offset);
      });
      const least = Math.min(...pings.map(([out, back]) => out + back));
      expect(clock.roundTripMs).toBeCloseTo(least, 6);
      expect(Math.abs(clock.offsetMs - offset)).toBeLessThanOrEqual(least / 2 + 1e-6);
    }),
  );
});

test("old and impossible pings are discarded", () => {
  const clock = new Clock(1000);
  expect(clock.offsetMs).toBeNaN();
  clock.add(10, 5, 0);
  expect(clock.roundTripMs).toBeNaN();
  clock.add(0, 1, 100.5);
  clock.add(1500, 1510, 1705);
  expect([clock.roundTripMs, clock.offsetMs]).toEqual([10, 200]);
});

test("lateness is relative to the fastest message of a window", () => {
  const lateness = new Lateness(100);
  expect(lateness.groundMs).toBeNaN();
  for (let k = 0; k < 1000; k++) lateness.add(16 * k + 50 + (k % 10 === 0 ? 30 : 0), 16 * k);
  expect(lateness.groundMs).toBe(50);
  expect(lateness.beyondGroundMs(0.5)).toBe(0);
  expect(lateness.beyondGroundMs(0.98)).toBe(30);
});
