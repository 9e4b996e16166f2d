import { describe, expect, test } from "vitest";
import { POSES, RIGS } from "../generated/mapping_vectors.js";
import { type MappedVerb, Mapper, type RestJoint } from "./mapper.js";
import { Standing } from "./standing.js";
import { add, length, multiply, type Q, rotate, STILL, sub, type V } from "./vector.js";

type Case = (typeof POSES)[number];

function jointsOf({ target, offsets, origin }: Case): RestJoint[] {
  const rig = RIGS.find((each) => each.rig === target);
  return (rig?.names ?? []).map((name, k) => ({
    name,
    parent: rig?.parents[k] ?? -1,
    rotation: STILL,
    position: (k === 0 ? origin : offsets[k]) as unknown as V,
  }));
}

/** Places of all joints of the target after a pose. */
function placesOf(mapper: Mapper, joints: readonly RestJoint[]): V[] {
  const driven = new Map(mapper.rows.map(({ target }, k) => [target, k]));
  const [turns, places]: [Q[], V[]] = [[], []];
  joints.forEach(({ parent, rotation, position }, j) => {
    const k = driven.get(j);
    const above = turns[parent] ?? STILL;
    const local = k === undefined ? rotation : multiply(mapper.before[k] as Q, mapper.local[k] as Q);
    turns.push(multiply(above, local));
    places.push(k === 0 ? mapper.root : add(places[parent] ?? [0, 0, 0], rotate(above, position)));
  });
  return places;
}

describe.each(POSES)("$verb.measure.effector on $target", (given) => {
  const joints = jointsOf(given);
  const verb = given.verb as unknown as MappedVerb;
  const mapper = new Mapper(verb, joints, { ground: 0 });

  test("lengths are scaled as by the library", () => {
    expect(mapper.scale).toBeCloseTo(given.scale, 5);
  });

  test("joints are where the library puts them", () => {
    given.values.forEach((values, n) => {
      mapper.apply(values, given.phases[n] as number);
      const places = placesOf(mapper, joints);
      mapper.rows.forEach(({ target }) => {
        const wanted = given.places[n]?.[target] as number[];
        const gap = Math.hypot(...(places[target] as V).map((value, a) => value - (wanted[a] as number)));
        expect(gap, `${joints[target]?.name} in pose ${n}`).toBeLessThan(0.01);
      });
    });
  });

  test("feet and effector are in their places", () => {
    given.values.forEach((values, n) => {
      mapper.apply(values, given.phases[n] as number);
      expect(mapper.figures.feet ?? 0).toBeLessThan(0.002);
    });
    mapper.apply(given.values[2] as number[], given.phases[2] as number);
    expect(mapper.figures.effector).toBeLessThan(0.001);
  });
});

test("pairs that are given replace those found by names", () => {
  const [first] = POSES as [Case];
  const joints = jointsOf(first);
  const verb = first.verb as unknown as MappedVerb;
  const mapper = new Mapper(verb, joints, { joints: { RightHand: "hand_l", Neck: "" } });
  const moved = new Map(
    mapper.rows.map(({ target, first: joint }) => [joints[target]?.name, verb.skeleton.names[joint]]),
  );
  expect(moved.get("hand_l")).toBe("RightHand");
  expect(moved.has("hand_r")).toBe(false);
  expect(moved.has("neck_01")).toBe(false);
});

test.each([
  ["Y-up", STILL],
  ["facing -Z", [0, 1, 0, 0]],
  ["Z-up", [Math.SQRT1_2, 0, 0, Math.SQRT1_2]],
] as [string, Q][])("pairs make a humanoid of unknown names, %s", (_, turn) => {
  const [given] = POSES as [Case];
  const verb = given.verb as unknown as MappedVerb;
  const joints = jointsOf(given).map((joint, k) =>
    k > 0 ? joint : { ...joint, rotation: turn, position: rotate(turn, joint.position) },
  );
  const named = new Mapper(verb, joints);
  const pairs = Object.fromEntries(
    named.rows.flatMap(({ target, first, bone }) =>
      bone in named.source.roles.bones ? [[verb.skeleton.names[first], `j${target}`]] : [],
    ),
  );
  const unknown = joints.map((joint, k) => ({ ...joint, name: `j${k}` }));
  const paired = new Mapper(verb, unknown, { joints: pairs });
  expect(paired.scale).toBeCloseTo(named.scale, 9);
  given.values.forEach((values, n) => {
    const positions = [named, paired].map((mapper) => {
      mapper.apply(values, given.phases[n] as number);
      return placesOf(mapper, joints);
    }) as [V[], V[]];
    for (const { target } of paired.rows)
      expect(length(sub(positions[1][target] as V, positions[0][target] as V)), joints[target]?.name).toBeLessThan(
        1e-6,
      );
  });
});

test("pairs of the spine keep it a spine", () => {
  const [given] = POSES as [Case];
  const verb = given.verb as unknown as MappedVerb;
  const mapper = new Mapper(verb, jointsOf(given), { joints: { Spine: "spine_01", Neck: "neck_01" } });
  expect(mapper.rows.filter((row) => row.given).map((row) => row.bone)).toEqual(["spine", "neck"]);
});

test.each(["hand_r", "lowerarm_r", "foot_l", "calf_l"])("a figure whose %s has no length has finite poses", (bone) => {
  const [given] = POSES as [Case];
  const joints = jointsOf(given).map((joint) =>
    joint.name === bone ? { ...joint, position: [0, 0, 0] as const } : joint,
  );
  const mapper = new Mapper(given.verb as unknown as MappedVerb, joints);
  given.values.forEach((values, n) => {
    mapper.apply(values, given.phases[n] as number);
    expect(mapper.rotations.flat().every(Number.isFinite)).toBe(true);
    expect(mapper.root.every(Number.isFinite)).toBe(true);
  });
});

test("a figure without known bones is refused", () => {
  const [first] = POSES as [Case];
  const joints: RestJoint[] = [{ name: "thing", parent: -1, rotation: STILL, position: [0, 0, 0] }];
  expect(() => new Mapper(first.verb as unknown as MappedVerb, joints)).toThrow(/known by name/);
});

test("a T-pose and an A-pose stand, and a figure that sits does not", () => {
  for (const given of POSES) expect(new Standing(jointsOf(given)).stands).toBe(true);
  const joints = jointsOf(POSES[0] as Case);
  const seated = joints.map((joint) =>
    joint.name.startsWith("thigh") ? { ...joint, rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2] as const } : joint,
  );
  expect(new Standing(seated).stands).toBe(false);
});
