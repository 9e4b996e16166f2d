import fc from "fast-check";
import { expect, test } from "vitest";
import type { Verb } from "../types";
import { AHEAD_S, clampGoal, type GoalSpace, goalSpaceOf, intersectPlane, jumpArc, velocityPath } from "./goal_space";
import { add, cross, dot, length, scale, sub, unit, type V3 } from "./vec";

type Kind = "joint_position" | "jump" | "root_velocity" | "none";

/** The fields of a verb that define its goal space. */
function verb(
  kind: Kind,
  names: readonly string[],
  points: readonly (readonly [number[], V3 | null])[],
  units: readonly string[] = [],
): Verb {
  return {
    adverbs: names.map((name, k) => ({ name, unit: units[k] ?? "m", min: -1, max: 1, style: false, description: "" })),
    measure: { kind, adverbs: [...names], effector: null, keytime: null, unit: "m" },
    examples: points.map(([numbers, point], k) => ({
      name: `e${k}`,
      adverbs: Object.fromEntries(names.map((name, i) => [name, numbers[i]])),
      keytimes: [],
      point,
    })),
    pseudo_examples: [],
  } as unknown as Verb;
}

const CORNERS: readonly number[][] = [
  [0, 0, 0],
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
  [1, 1, 0.5],
];

const number = fc.double({ min: -1, max: 1, noNaN: true });
const vector = fc.tuple(number, number, number);

function spaceOf(of: Verb): GoalSpace {
  const found = goalSpaceOf(of);
  if (!found) throw new Error("no space");
  return found;
}

test("two adverbs map to a plane fitted to the examples, and back", () => {
  fc.assert(
    fc.property(vector, vector, vector, number, number, (origin, a, b, u, v) => {
      fc.pre(length(cross(a, b)) > 0.05);
      const at = (numbers: readonly number[]): V3 =>
        add(origin, add(scale(a, numbers[0] as number), scale(b, numbers[1] as number)));
      const sheet = spaceOf(
        verb(
          "joint_position",
          ["u", "v"],
          CORNERS.map((c) => [c, at(c)]),
        ),
      );
      expect(sheet.kind).toBe("sheet");
      const point = sheet.point({ u, v });
      expect(length(sub(point, at([u, v])))).toBeLessThan(1e-9);
      expect(dot(sheet.plane?.normal as V3, a)).toBeCloseTo(0, 9);
      const back = sheet.adverbs(point, { u: 9, v: 9, tired: 0.3 });
      expect(back.u).toBeCloseTo(u, 6);
      expect(back.v).toBeCloseTo(v, 6);
      expect(back.tired).toBe(0.3);
    }),
  );
});

test("a goal off the plane maps to its nearest point", () => {
  const sheet = spaceOf(
    verb(
      "joint_position",
      ["u", "v"],
      CORNERS.map(([u = 0, v = 0]) => [
        [u, v],
        [u, v, 0],
      ]),
    ),
  );
  expect(sheet.adverbs([0.25, 0.5, 3], {})).toEqual({ u: expect.closeTo(0.25, 9), v: expect.closeTo(0.5, 9) });
});

test("three adverbs map to space, also with oblique axes", () => {
  const at = ([a = 0, b = 0, c = 0]: readonly number[]): V3 => [a + 0.4 * b, 2 * c, b - 0.3 * a + 1];
  const space = spaceOf(
    verb(
      "joint_position",
      ["a", "b", "c"],
      CORNERS.map((c) => [c, at(c)]),
    ),
  );
  expect([space.kind, space.plane]).toEqual(["space", null]);
  expect(space.adverbs(at([0.2, -0.7, 0.4]), {})).toEqual({
    a: expect.closeTo(0.2, 6),
    b: expect.closeTo(-0.7, 6),
    c: expect.closeTo(0.4, 6),
  });
});

test("a fit with a residual above 5 mm gives no goal space", () => {
  const bulged = (by: number) =>
    verb(
      "joint_position",
      ["u", "v"],
      CORNERS.map(([u = 0, v = 0], k) => [
        [u, v],
        [u, v, k === 4 ? by : 0],
      ]),
    );
  expect(goalSpaceOf(bulged(0.004))).not.toBeNull();
  expect(goalSpaceOf(bulged(0.05))).toBeNull();
});

test("too few or collinear points give no goal space", () => {
  expect(
    goalSpaceOf(
      verb(
        "joint_position",
        ["u", "v"],
        [
          [
            [0, 0],
            [0, 0, 0],
          ],
          [
            [1, 0],
            [1, 0, 0],
          ],
        ],
      ),
    ),
  ).toBeNull();
  const line = [0, 1, 2, 3].map((t): [number[], V3] => [
    [t, t],
    [t, 0, 0],
  ]);
  expect(goalSpaceOf(verb("joint_position", ["u", "v"], line))).toBeNull();
});

test("without measured points only adverbs named x, y and z are positions", () => {
  const unknown = CORNERS.map((c): [number[], null] => [c, null]);
  expect(spaceOf(verb("joint_position", ["x", "y", "z"], unknown)).point({ x: 1, y: 2, z: 3 })).toEqual([1, 2, 3]);
  expect(spaceOf(verb("joint_position", ["x", "y"], unknown)).point({ x: 1, y: 2 })).toEqual([1, 2, 0]);
  expect(goalSpaceOf(verb("joint_position", ["u", "v"], unknown))).toBeNull();
  expect(goalSpaceOf(verb("none", [], []))).toBeNull();
});

test("a jump lands at its distance and direction from +Z toward +X; height is kept", () => {
  const names = ["distance", "direction", "height"];
  const jump = spaceOf(verb("jump", names, []));
  const [x, y, z] = jump.point({ distance: 2, direction: Math.PI / 2, height: 0.3 });
  expect([x, y, z]).toEqual([expect.closeTo(2, 9), 0, expect.closeTo(0, 9)]);
  expect(jump.adverbs([-1, 0, 0], { height: 0.3 })).toEqual({
    distance: 1,
    direction: expect.closeTo(-Math.PI / 2, 9),
    height: 0.3,
  });
  expect(jump.adverbs([0, 0, 0.001], { direction: 0.7, height: 0 }).direction).toBe(0.7);
});

test("a jump in centimetres and degrees is drawn in metres", () => {
  const names = ["distance", "direction", "height"];
  const jump = spaceOf(verb("jump", names, [], ["cm", "deg", "cm"]));
  const goal = { distance: 200, direction: 90, height: 30 };
  const [x, y, z] = jump.point(goal);
  expect([x, y, z]).toEqual([expect.closeTo(2, 9), 0, expect.closeTo(0, 9)]);
  expect(jump.adverbs([-1, 0, 0], goal)).toEqual({
    distance: expect.closeTo(100, 9),
    direction: expect.closeTo(-90, 9),
    height: 30,
  });
  expect(jumpArc(jump, names, goal, 10)[5 * 3 + 1]).toBeCloseTo(0.3, 6);
});

test("a velocity in km/h is drawn in metres per second", () => {
  const names = ["forward_speed", "turn_rate", "sideways_speed"];
  const arrow = spaceOf(verb("root_velocity", names, [], ["km/h", "deg/s", "m/s"]));
  expect(arrow.point({ forward_speed: 3.6, turn_rate: 0, sideways_speed: 1 })).toEqual([
    AHEAD_S,
    0,
    expect.closeTo(AHEAD_S, 9),
  ]);
});

test("the arc of a jump starts on the ground, rises by its height and ends at the goal", () => {
  const names = ["distance", "direction", "height"];
  const adverbs = { distance: 1.2, direction: 0.4, height: 0.35 };
  const jump = spaceOf(verb("jump", names, []));
  const points = jumpArc(jump, names, adverbs, 10);
  expect(Array.from(points.slice(0, 3))).toEqual([0, 0, 0]);
  expect(points[5 * 3 + 1]).toBeCloseTo(0.35, 6);
  expect(length(sub(Array.from(points.slice(30)) as unknown as V3, jump.point(adverbs)))).toBeLessThan(1e-6);
});

test("a velocity points forward along +Z and sideways along +X; the turn rate is kept", () => {
  const names = ["forward_speed", "turn_rate", "sideways_speed"];
  const arrow = spaceOf(verb("root_velocity", names, []));
  const adverbs = { forward_speed: 1.5, turn_rate: 0.8, sideways_speed: -0.2 };
  expect(arrow.point(adverbs)).toEqual([-0.2 * AHEAD_S, 0, 1.5 * AHEAD_S]);
  expect(arrow.adverbs(arrow.point(adverbs), { ...adverbs, forward_speed: 0, sideways_speed: 0 })).toEqual(adverbs);
});

test("the path of a turning walk is a circle of radius speed / turn rate", () => {
  const names = ["forward_speed", "turn_rate", "sideways_speed"];
  const [speed, turn, steps] = [2, 1.5, 400];
  const points = velocityPath(
    spaceOf(verb("root_velocity", names, [])),
    names,
    { forward_speed: speed, turn_rate: turn, sideways_speed: 0 },
    steps,
  );
  const radius = speed / turn;
  for (let k = 0; k <= steps; k += 50) {
    expect(Math.hypot((points[3 * k] as number) - radius, points[3 * k + 2] as number)).toBeCloseTo(radius, 4);
  }
  expect(points[3 * steps]).toBeCloseTo(radius * (1 - Math.cos(turn * AHEAD_S)), 4);
});

test("a dragged goal is clamped to its range plus half a range", () => {
  const of = verb("joint_position", ["x", "y"], []);
  expect(clampGoal(of, { x: 40, y: -1.2 })).toEqual({ x: 2, y: -1.2 });
});

test("a ray intersects a plane only in front of its origin", () => {
  expect(intersectPlane([0, 1, 0], unit([0, -1, 1]), [5, 0, 5], [0, 1, 0])).toEqual([
    0,
    expect.closeTo(0, 9),
    expect.closeTo(1, 9),
  ]);
  expect(intersectPlane([0, 1, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0])).toBeNull();
  expect(intersectPlane([0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0])).toBeNull();
});
