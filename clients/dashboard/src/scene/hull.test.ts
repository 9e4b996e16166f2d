import { expect, test } from "vitest";
import type { Verb } from "../types";
import { type ExamplePoint, type GoalSpace, goalSpaceOf } from "./goal_space";
import { convexOutline, hullOf } from "./hull";

const names = ["x", "y", "z"];

function verb(numbers: readonly number[][], chart: string, used = names): Verb {
  return {
    adverbs: used.map((name) => ({ name, unit: "m", min: -1, max: 1, style: false, description: "" })),
    measure: { kind: "joint_position", adverbs: used, effector: null, keytime: null, unit: "m" },
    examples: numbers.map((row, k) => {
      const adverbs = Object.fromEntries(used.map((name, i) => [name, row[i]]));
      return { name: `e${k}`, adverbs, keytimes: [], point: null };
    }),
    pseudo_examples: [],
    domain: { chart, chart_axes: [0, 1, 2], chart_bend: [0, 0, Math.PI, 1], scale: [1, 1, 1] },
  } as unknown as Verb;
}

function hull(of: Verb) {
  return hullOf(of, goalSpaceOf(of) as GoalSpace, of.examples as unknown as ExamplePoint[]);
}

const CUBE = [-1, 1].flatMap((x) => [0, 2].flatMap((y) => [-1, 1].map((z) => [x, y, z])));

test("the convex outline omits points inside and on an edge", () => {
  const corners = convexOutline([
    [0, 0],
    [2, 0],
    [2, 2],
    [0, 2],
    [1, 1],
    [1, 0],
    [0, 0],
  ]);
  expect([...corners].sort()).toEqual([
    [0, 0],
    [0, 2],
    [2, 0],
    [2, 2],
  ]);
});

test("a cube has twelve edges without diagonals, and faces that enclose its volume", () => {
  const found = hull(verb([...CUBE, [0, 1, 0]], "identity"));
  expect(found?.edges.length).toBe(12 * 6);
  expect(volume(found?.faces as Float32Array)).toBeCloseTo(8, 5);
});

test("coplanar examples of three adverbs, and two examples of two adverbs, have no hull", () => {
  expect(
    hull(
      verb(
        [
          [0, 0, 0],
          [1, 0, 0],
          [0, 0, 1],
          [1, 0, 1],
          [0.5, 0, 0.2],
        ],
        "identity",
      ),
    ),
  ).toBeNull();
  expect(
    hull(
      verb(
        [
          [0, 0],
          [1, 1],
        ],
        "identity",
        ["x", "y"],
      ),
    ),
  ).toBeNull();
});

test("two adverbs give the polygon of their examples", () => {
  const found = hull(
    verb(
      [
        [0, 0],
        [1, 0],
        [1, 1],
        [0, 1],
        [0.4, 0.6],
      ],
      "identity",
      ["x", "y"],
    ),
  );
  expect([found?.edges.length, found?.faces.length]).toEqual([4 * 6, 2 * 9]);
});

test("a cylindrical domain is curved: its faces stay away from the axis", () => {
  const around = [0, 1, 2, 3, 4].flatMap((k) => {
    const angle = -2 + k;
    return [0.8, 1.2].flatMap((r) => [0.5, 1.5].map((y) => [r * Math.sin(angle), y, r * Math.cos(angle)]));
  });
  const found = hull(verb(around, "cylinder"));
  const radii = (of: Float32Array) =>
    Array.from({ length: of.length / 3 }, (_, k) => Math.hypot(of[3 * k] as number, of[3 * k + 2] as number));
  expect(Math.min(...radii(found?.faces as Float32Array))).toBeGreaterThan(0.799);
  expect(Math.abs(volume(found?.faces as Float32Array))).toBeCloseTo(0.5 * 4 * (1.44 - 0.64), 1);
});

function volume(faces: Float32Array): number {
  let sum = 0;
  for (let f = 0; f < faces.length; f += 9) {
    const [ax, ay, az, bx, by, bz, cx, cy, cz] = faces.subarray(f, f + 9) as unknown as [
      number,
      number,
      number,
      number,
      number,
      number,
      number,
      number,
      number,
    ];
    sum += (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6;
  }
  return sum;
}
