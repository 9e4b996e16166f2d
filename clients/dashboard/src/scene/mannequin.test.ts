import { Vector3 } from "three";
import { describe, expect, test } from "vitest";
import type { Skeleton } from "../types";
import { anatomyOf, isChain, isHuman } from "./anatomy";
import { mannequin, planOf } from "./mannequin";

type Row = readonly [name: string, parent: number, x: number, y: number, z: number];

function skeleton(rows: readonly Row[], tips: Skeleton["tips"] = []): Skeleton {
  return {
    names: rows.map(([name]) => name),
    parents: rows.map(([, parent]) => parent),
    offsets: rows.map(([, , x, y, z]) => [x, y, z]),
    tips,
  };
}

/** A human skeleton with joint names mapped by `name`. */
function person(name: (plain: string) => string = (plain) => plain): Skeleton {
  const half = (side: string, s: number, at: number): Row[] => [
    [name(`${side}Shoulder`), 2, s * 0.03, 0.11, 0.02],
    [name(`${side}Arm`), at, s * 0.15, 0, -0.02],
    [name(`${side}ForeArm`), at + 1, s * 0.29, 0, 0],
    [name(`${side}Hand`), at + 2, s * 0.26, 0, 0],
    [name(`${side}UpLeg`), 0, s * 0.095, -0.05, 0],
    [name(`${side}Leg`), at + 4, 0, -0.43, 0],
    [name(`${side}Foot`), at + 5, 0, -0.42, 0],
    [name(`${side}ToeBase`), at + 6, 0, -0.06, 0.14],
  ];
  const trunk: Row[] = [
    [name("Hips"), -1, 0, 0, 0],
    [name("Spine"), 0, 0, 0.12, 0],
    [name("Spine1"), 1, 0, 0.22, 0],
    [name("Neck"), 2, 0, 0.17, 0],
    [name("Head"), 3, 0, 0.1, 0.02],
  ];
  const tips = [
    { parent: 4, offset: [0, 0.17, 0.02] },
    { parent: 8, offset: [0.17, 0, 0] },
    { parent: 12, offset: [0, 0, 0.07] },
  ];
  return skeleton([...trunk, ...half("Left", 1, 5), ...half("Right", -1, 13)], tips);
}

const ARM = skeleton([
  ["A", -1, 0, 0, 0],
  ["B", 0, 0.4, 0, 0],
  ["C", 1, 0.35, 0, 0],
  ["D", 2, 0.25, 0, 0],
]);

/** Four legs, a neck, and meaningless names. */
const BEAST = skeleton(
  [
    ["q0", -1, 0, 0, 0],
    ["q1", 0, 0, 0.05, 0.6],
    ["q2", 1, 0, 0.3, 0.2],
    ...[0, 0, 1, 1].flatMap((at, k): Row[] => [
      [`leg${k}a`, at, k % 2 ? 0.15 : -0.15, -0.05, 0],
      [`leg${k}b`, 3 + 2 * k, 0, -0.35, 0.03],
    ]),
  ],
  [{ parent: 4, offset: [0, -0.3, 0] }],
);

test("human skeletons are recognised by the joint names of several tools", () => {
  expect(isHuman(anatomyOf(person()))).toBe(true);
  expect(isHuman(anatomyOf(person((plain) => `mixamorig:${plain}`)))).toBe(true);
  const others: Record<string, string> = { UpLeg: "thigh", Leg: "calf", ForeArm: "lowerarm", Arm: "upperarm" };
  const unreal = (plain: string) => {
    const [, side = "", part = plain] = /^(Left|Right)(.*)$/.exec(plain) ?? [];
    return `${others[part] ?? part.toLowerCase()}${side && `_${side[0]?.toLowerCase()}`}`;
  };
  expect(isHuman(anatomyOf(person(unreal)))).toBe(true);
  expect(isHuman(anatomyOf(BEAST))).toBe(false);
});

test("body axes are found in every orientation of the rest pose", () => {
  const turned = person();
  turned.offsets = turned.offsets.map(([x, y, z]) => [x as number, -(z as number), y as number]);
  turned.tips = turned.tips.map(({ parent, offset: [x, y, z] }) => {
    return { parent, offset: [x as number, -(z as number), y as number] };
  });
  const { up, left, forward } = anatomyOf(turned);
  expect(up[2]).toBeGreaterThan(0.99);
  expect(left[0]).toBeCloseTo(1, 6);
  expect(forward[1]).toBeLessThan(-0.99);
});

test("every joint of a human has parts, equal on both sides", () => {
  const parts = planOf(person());
  const on = (joint: number) => parts.filter((part) => part.joint === joint).map((part) => [part.form, part.tone]);
  for (let joint = 5; joint < 13; joint++) {
    if (joint !== 8) expect(on(joint)).toEqual(on(joint + 8));
    expect(on(joint).length).toBeGreaterThan(0);
  }
  expect(on(4)).toEqual([["loft", "body"]]);
});

test("a human of twice the size has parts of twice the size", () => {
  const large = person();
  large.offsets = large.offsets.map((offset) => offset.map((x) => 2 * x));
  large.tips = large.tips.map(({ parent, offset }) => ({ parent, offset: offset.map((x) => 2 * x) }));
  const [one, two] = [extent(person()), extent(large)];
  expect(two.x / one.x).toBeCloseTo(2, 2);
  expect(two.y / one.y).toBeCloseTo(2, 2);
  expect(two.z / one.z).toBeCloseTo(2, 2);
});

test("the parts of a human have human proportions", () => {
  const { x, y, z } = extent(person());
  expect(y).toBeGreaterThan(0.06 + 0.42 + 0.43 + 0.05 + 0.34 + 0.27 + 0.17);
  expect(y).toBeLessThan(1.9);
  expect(z).toBeLessThan(0.42);
  expect(x).toBeLessThan(1.85);
});

test("one chain of fingers is drawn as four fingers beside the thumb", () => {
  const palm = person().names.indexOf("LeftHand");
  const rows: Row[] = person().names.map((name, j) => {
    const [x, y, z] = person().offsets[j] as [number, number, number];
    return [name, person().parents[j] as number, x, y, z];
  });
  const at = rows.length;
  rows.push(["LeftHandMiddle1", palm, 0.09, 0, 0], ["LeftHandMiddle2", at, 0.04, 0, 0]);
  rows.push(["LeftHandThumb1", palm, 0.03, -0.01, 0.03]);
  const tips = [
    { parent: 4, offset: [0, 0.17, 0.02] },
    { parent: at + 1, offset: [0.04, 0, 0] },
    { parent: at + 2, offset: [0.04, -0.02, 0.04] },
  ];
  const parts = planOf(skeleton(rows, tips));
  const lofts = (joint: number) => parts.filter((part) => part.joint === joint && part.form === "loft").length;
  expect([at, at + 1, at + 2].map(lofts)).toEqual([4, 4, 1]);
  expect(lofts(palm)).toBe(1);
});

test("an arm has links behind the plane of its tip", () => {
  expect(isChain(anatomyOf(ARM))).toBe(true);
  const parts = planOf(ARM);
  expect(parts.filter((part) => part.form === "bar").map((part) => part.joint)).toEqual([0, 1, 2]);
  const geometries = mannequin(ARM, "high");
  for (const geometry of geometries.values()) {
    geometry.computeBoundingBox();
    expect(geometry.boundingBox?.max.z).toBeLessThan(0.005);
  }
});

test("unknown bodies have thicker limbs where more segments are attached", () => {
  const parts = planOf(BEAST);
  const width = (joint: number) => {
    const part = parts.find((one) => one.joint === joint && one.form === "loft");
    return part?.form === "loft" ? (part.stations[0]?.wide ?? 0) : 0;
  };
  expect(width(0)).toBeGreaterThan(width(3));
  expect(width(3)).toBeGreaterThan(width(4));
  expect(width(4)).toBeGreaterThan(0);
});

describe.each([
  ["person", person()],
  ["arm", ARM],
  ["beast", BEAST],
] as const)("the shapes of a %s", (_, of) => {
  test.each(["high", "low"] as const)("are closed, face outwards and have unit normals, detail %s", (detail) => {
    for (const geometry of mannequin(of, detail).values()) {
      const [points, normals] = [geometry.getAttribute("position"), geometry.getAttribute("normal")];
      expect(Array.from(points.array).every(Number.isFinite)).toBe(true);
      for (let k = 0; k < normals.count; k++) {
        expect(new Vector3().fromBufferAttribute(normals, k).length()).toBeCloseTo(1, 3);
      }
      expect(volume(points.array, geometry.index?.array ?? [])).toBeGreaterThan(0);
      geometry.dispose();
    }
  });
});

test("low detail has a third of the triangles or fewer", () => {
  const count = (detail: "high" | "low") =>
    [...mannequin(person(), detail).values()].reduce((sum, geometry) => sum + (geometry.index?.count ?? 0) / 3, 0);
  expect(count("low")).toBeLessThan(count("high") / 3);
  expect(count("low")).toBeGreaterThan(500);
});

/** Volume that triangles enclose: positive where they face outwards. */
function volume(points: ArrayLike<number>, faces: ArrayLike<number>): number {
  const corner = (k: number) => new Vector3().fromArray(points as number[], 3 * (faces[k] as number));
  let sum = 0;
  for (let f = 0; f < faces.length; f += 3) sum += corner(f).dot(corner(f + 1).cross(corner(f + 2))) / 6;
  return sum;
}

/** Size of the whole figure in its rest pose. */
function extent(of: Skeleton): Vector3 {
  const { positions } = anatomyOf(of);
  const [low, high] = [new Vector3().setScalar(1e9), new Vector3().setScalar(-1e9)];
  for (const [joint, geometry] of mannequin(of, "low")) {
    geometry.computeBoundingBox();
    const at = new Vector3(...(positions[joint] as [number, number, number]));
    low.min(at.clone().add(geometry.boundingBox?.min ?? at));
    high.max(at.clone().add(geometry.boundingBox?.max ?? at));
    geometry.dispose();
  }
  return high.sub(low);
}
