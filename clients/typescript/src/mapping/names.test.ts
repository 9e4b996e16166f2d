import { expect, test } from "vitest";
import { LABELS, RIGS } from "../generated/mapping_vectors.js";
import { label, rolesOf } from "./names.js";

test("names have the sides and plain names that the library finds", () => {
  for (const [name, [side, plain]] of Object.entries(LABELS)) expect(label(name), name).toEqual([side, plain]);
});

test("presets have the bones that the library finds", () => {
  for (const { rig, names, parents, bones, spine, neck } of RIGS)
    expect(rolesOf(names, parents), rig).toEqual({ bones, spine, neck });
});

test("arms of Motive have their sides and their parts", () => {
  const names = ["Hip", "Chest", "LShoulder", "LUArm", "LFArm", "LHand", "RShoulder", "RUArm", "RFArm", "RHand"];
  const { bones } = rolesOf(names, [-1, 0, 1, 2, 3, 4, 1, 6, 7, 8]);
  expect(bones).toMatchObject({ leftShoulder: 2, leftUpperArm: 3, leftLowerArm: 4, leftHand: 5 });
  expect(bones).toMatchObject({ rightShoulder: 6, rightUpperArm: 7, rightLowerArm: 8, rightHand: 9 });
});

test("bones that a file names win", () => {
  const [vrm] = RIGS;
  const names = (vrm?.names ?? []).map((_, k) => `node ${k}`);
  expect(rolesOf(names, vrm?.parents ?? [], vrm?.bones as Record<string, number>).spine).toEqual(vrm?.spine);
});
