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

test("bones that a file names win", () => {
  const [vrm] = RIGS;
  const names = (vrm?.names ?? []).map((_, k) => `node ${k}`);
  expect(rolesOf(names, vrm?.parents ?? [], vrm?.bones as Record<string, number>).spine).toEqual(vrm?.spine);
});
