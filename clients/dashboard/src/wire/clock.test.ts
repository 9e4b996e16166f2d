import fc from "fast-check";
import { expect, test } from "vitest";
import { Clock, Lateness } from "./clock";

test("the offset is known to half the least round trip, however pings are delayed", () => {
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

test("old pings are forgotten, and impossible ones not taken", () => {
  const clock = new Clock(1000);
  expect(clock.offsetMs).toBeNaN();
  clock.add(10, 5, 0);
  expect(clock.roundTripMs).toBeNaN();
  clock.add(0, 1, 100.5);
  clock.add(1500, 1510, 1705);
  expect([clock.roundTripMs, clock.offsetMs]).toEqual([10, 200]);
});

test("lateness is measured from the earliest message, over a window", () => {
  const lateness = new Lateness(100);
  expect(lateness.groundMs).toBeNaN();
  for (let k = 0; k < 1000; k++) lateness.add(16 * k + 50 + (k % 10 === 0 ? 30 : 0), 16 * k);
  expect(lateness.groundMs).toBe(50);
  expect(lateness.beyondGroundMs(0.5)).toBe(0);
  expect(lateness.beyondGroundMs(0.98)).toBe(30);
});
