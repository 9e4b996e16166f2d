/** The evaluator against the library's answers, tests/golden/evaluator_vectors.v1.json. */

import { readFileSync } from "node:fs";
import { beforeAll, describe, expect, test } from "vitest";
import { ArtifactError, BadRequest, UnknownName } from "../errors.js";
import { readContainer } from "./container.js";
import { type EvaluatedPose, Evaluator, type EvaluatorMethod } from "./evaluator.js";

const ROOT = new URL("../../../../", import.meta.url);

interface Found {
  at: { phase: number; time: number; duration: number };
  positions: number[][];
}
interface Vectors {
  tolerance_m: number;
  verbs: {
    file: string;
    weights: (Found & { weights: number[]; phase: number })[];
    adverbs: (Found & {
      adverbs: Record<string, number>;
      method: EvaluatorMethod;
      phase?: number;
      time?: number;
      clamped: boolean;
      weights: number[];
    })[];
  }[];
}

const vectors = JSON.parse(readFileSync(new URL("tests/golden/evaluator_vectors.v1.json", ROOT), "utf8")) as Vectors;

const fileOf = (name: string) => new Uint8Array(readFileSync(new URL(name, ROOT)));

function check(evaluator: Evaluator, pose: EvaluatedPose, { at, positions }: Found): void {
  expect(pose.phase).toBeCloseTo(at.phase, 6);
  expect(pose.timeS).toBeCloseTo(at.time, 6);
  expect(pose.durationS).toBeCloseTo(at.duration, 6);
  const found = evaluator.positions(pose.values);
  const distances = positions.map((point, j) =>
    Math.hypot(...point.map((value, a) => value - (found[3 * j + a] as number))),
  );
  expect(Math.max(...distances)).toBeLessThanOrEqual(vectors.tolerance_m);
}

describe.each(vectors.verbs)("$file", ({ file, weights, adverbs }) => {
  let evaluator: Evaluator;
  beforeAll(async () => {
    evaluator = await Evaluator.load(fileOf(file));
  });

  test("poses of weights", () => {
    for (const each of weights) check(evaluator, evaluator.poseOf(each.weights, { phase: each.phase }), each);
  });

  test("poses of adverbs", () => {
    for (const each of adverbs) {
      const { method, phase, time } = each;
      const instant = phase !== undefined ? { phase } : { timeS: time as number };
      const pose = evaluator.pose(each.adverbs, { method, ...instant });
      expect(pose.clamped).toBe(each.clamped);
      each.weights.forEach((weight, k) => {
        expect(pose.weights[k]).toBeCloseTo(weight, 7);
      });
      check(evaluator, pose, each);
    }
  });
});

test("the vectors have clamped adverbs and pseudo-examples", () => {
  expect(vectors.verbs.some(({ adverbs }) => adverbs.some(({ clamped }) => clamped))).toBe(true);
  const { facts, arrays } = readContainer(fileOf("tests/golden/refined.v1.verb"));
  const centers = (name: string) => arrays.get(`bases.${name}.centers`)?.shape[0] ?? 0;
  expect(centers("refined")).toBeGreaterThan(centers("rbf"));
  expect(facts.rotation_mode).toBe(1);
});

test("a damaged, cut or newer file is rejected", async () => {
  const file = fileOf("tests/golden/arm.v1.verb");
  const damaged = file.slice();
  damaged[damaged.length - 3] = (damaged.at(-3) as number) ^ 1;
  await expect(Evaluator.load(damaged)).rejects.toThrow("checksum");
  await expect(Evaluator.load(file.slice(0, -8))).rejects.toThrow("does not fit");
  await expect(Evaluator.load(file.slice(0, 12))).rejects.toBeInstanceOf(ArtifactError);
  await expect(Evaluator.load(new Uint8Array(64))).rejects.toBeInstanceOf(ArtifactError);
  const text = new TextDecoder("latin1").decode(file).replace('\\"format\\": 1', '\\"format\\": 9');
  const newer = Uint8Array.from(text, (character) => character.charCodeAt(0));
  await expect(Evaluator.load(newer)).rejects.toThrow("format 9");
});

test("wrong names and numbers are rejected", async () => {
  const evaluator = await Evaluator.load(fileOf("verbs/library/arm3.verb"));
  expect(() => evaluator.pose({ x: 0.5, y: 0.2, z: 1 })).toThrow(UnknownName);
  expect(() => evaluator.pose({ x: 0.5 })).toThrow("missing adverb y");
  expect(() => evaluator.pose({ x: 0.5, y: Number.NaN })).toThrow(BadRequest);
  expect(() => evaluator.pose([0.5, 0.2], { phase: 1.5 })).toThrow("0 to 1");
  expect(() => evaluator.poseOf([1])).toThrow("9 examples");
});

test("an instant is a phase or a time, and both agree", async () => {
  const evaluator = await Evaluator.load(fileOf("verbs/library/walk.verb"));
  const middle = evaluator.verb.adverbs.map(({ min, max }) => (min + max) / 2);
  for (const phase of [0, 0.2, 0.77, 1.4, 3.9]) {
    const first = evaluator.pose(middle, { phase });
    const second = evaluator.pose(middle, { timeS: first.timeS });
    expect(second.phase).toBeCloseTo(phase, 9);
    second.values.forEach((value, k) => {
      expect(value).toBeCloseTo(first.values[k] as number, 6);
    });
  }
});
