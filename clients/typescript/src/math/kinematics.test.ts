import fc from "fast-check";
import { Object3D, Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import { poseLength } from "../wire/decode.js";
import { rigOf, solve, writeMatrix } from "./kinematics.js";
import { heading } from "./quaternion.js";

/** A random skeleton with a random pose of it: parents before children, unit quaternions. */
const posed = fc.integer({ min: 1, max: 12 }).chain((joints) =>
  fc.record({
    parents: fc.tuple(...Array.from({ length: joints }, (_, j) => (j ? fc.nat(j - 1) : fc.constant(-1)))),
    offsets: fc.array(vector(), { minLength: joints, maxLength: joints }),
    root: vector(),
    rotations: fc.array(turn(), { minLength: joints, maxLength: joints }),
  }),
);

function vector() {
  const number = fc.double({ min: -1, max: 1, noNaN: true });
  return fc.tuple(number, number, number);
}

function turn() {
  const axis = vector().map(([x, y, z]) => new Vector3(x, y, z + 2).normalize());
  const angle = fc.double({ min: -3, max: 3, noNaN: true });
  return fc.tuple(axis, angle).map(([about, by]) => new Quaternion().setFromAxisAngle(about, by).toArray());
}

/** The same pose as a hierarchy of three's own objects. */
function hierarchy(pose: {
  parents: number[];
  offsets: number[][];
  root: number[];
  rotations: number[][];
}): Object3D[] {
  const joints = pose.parents.map(() => new Object3D());
  for (const [j, joint] of joints.entries()) {
    const parent = pose.parents[j] as number;
    joints[parent]?.add(joint);
    joint.position.fromArray((parent < 0 ? pose.root : pose.offsets[j]) as number[]);
    joint.quaternion.fromArray(pose.rotations[j] as [number, number, number, number]);
  }
  joints[0]?.updateMatrixWorld(true);
  return joints;
}

test("positions and matrices equal those of a three.js hierarchy", () => {
  fc.assert(
    fc.property(posed, ({ parents, offsets, root, rotations }) => {
      const rig = rigOf({ names: parents.map(String), parents, offsets });
      const [before, shift] = [5, Float32Array.from([1, 0, -2])];
      const poses = new Float32Array(before + poseLength(rig.joints));
      poses.set([...root, ...rotations.flat()], before);
      const [positions, global] = [new Float32Array(3 * rig.joints), new Float32Array(4 * rig.joints)];
      solve(rig, poses, before, positions, global);
      for (const [j, joint] of hierarchy({ parents, offsets, root, rotations }).entries()) {
        const matrix = new Float32Array(16);
        writeMatrix(positions, global, j, shift, matrix, 0);
        const expected = joint.matrixWorld.toArray();
        for (const k of [0, 1, 2]) expected[12 + k] = (expected[12 + k] as number) + (shift[k] as number);
        for (const [k, value] of matrix.entries()) expect(value).toBeCloseTo(expected[k] as number, 4);
      }
    }),
    { numRuns: 60 },
  );
});

test("the heading is measured from +Z toward +X, independent of the lean", () => {
  const lean = new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), 0.4);
  for (const angle of [-3, -1.2, 0, 0.7, 2.9]) {
    const turned = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), angle).multiply(lean);
    expect(heading(Float32Array.from(turned.toArray()), 0)).toBeCloseTo(angle, 5);
  }
});
