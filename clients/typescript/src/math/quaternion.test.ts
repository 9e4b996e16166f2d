import fc from "fast-check";
import { Euler, Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import { heading, multiply, rotate, slerp } from "./quaternion.js";

const part = fc.double({ min: -1, max: 1, noNaN: true });
const rotation = fc
  .tuple(part, part, part, part)
  .filter((q) => Math.hypot(...q) > 0.1)
  .map((q) => new Quaternion(...q).normalize());
const place = fc.tuple(part, part, part).map((v) => new Vector3(...v));
const share = fc.double({ min: 0, max: 1, noNaN: true });

test("products and rotated vectors equal those of three.js", () => {
  fc.assert(
    fc.property(rotation, rotation, place, (a, b, v) => {
      const out = new Float64Array(8);
      multiply(out, 1, a.toArray(), 0, b.toArray(), 0);
      expect(a.clone().multiply(b).angleTo(new Quaternion().fromArray(out, 1))).toBeLessThan(1e-6);
      rotate(out, 5, a.toArray(), 0, v.toArray(), 0);
      expect(v.clone().applyQuaternion(a).distanceTo(new Vector3().fromArray(out, 5))).toBeLessThan(1e-12);
    }),
  );
});

test("slerp follows the shorter arc at constant speed", () => {
  fc.assert(
    fc.property(rotation, rotation, share, (a, b, t) => {
      const out = [0, 0, 0, 0];
      slerp(out, 0, a.toArray(), 0, b.toArray(), 0, t);
      const angle = a.angleTo(b);
      fc.pre(angle < Math.PI - 1e-3);
      const result = new Quaternion().fromArray(out);
      expect(result.length()).toBeCloseTo(1, 9);
      expect(a.angleTo(result)).toBeCloseTo(t * angle, 4);
      expect(result.angleTo(b)).toBeCloseTo((1 - t) * angle, 4);
    }),
  );
});

test("slerp extrapolates beyond the end", () => {
  const a = new Quaternion();
  const b = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 0.2);
  const out = [0, 0, 0, 0];
  slerp(out, 0, a.toArray(), 0, b.toArray(), 0, 1.5);
  expect(new Quaternion().fromArray(out).angleTo(a)).toBeCloseTo(0.3, 6);
});

test("the heading is the rotation about +Y, independent of pitch", () => {
  for (const turn of [-3, -1, 0, 0.5, 2.9])
    for (const pitch of [-0.7, 0, 0.7]) {
      const q = new Quaternion().setFromEuler(new Euler(pitch, turn, 0, "YXZ"));
      expect(heading(q.toArray(), 0)).toBeCloseTo(turn, 9);
    }
});
