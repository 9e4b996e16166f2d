/** Characters evaluated from rare records, against the evaluator at every instant. */

import { readFileSync } from "node:fs";
import { beforeAll, describe, expect, test } from "vitest";
import { Evaluator } from "../evaluator/evaluator.js";
import { FLAGS } from "../wire/decode.js";
import { Recipe, type RecipeRecord } from "./recipe.js";

const LIBRARY = new URL("../../../../verbs/library/", import.meta.url);
const START_MS = 1_000_000;

let walk: Evaluator;
let punch: Evaluator;

beforeAll(async () => {
  walk = await Evaluator.load(new Uint8Array(readFileSync(new URL("locomotion.verb", LIBRARY))));
  punch = await Evaluator.load(new Uint8Array(readFileSync(new URL("punch.verb", LIBRARY))));
});

const WALKING = { forward_speed: 1.3, turn_rate: 0.5, sideways_speed: 0 };

function record(evaluator: Evaluator, weights: ArrayLike<number>, at: number, more: Partial<RecipeRecord> = {}) {
  const { phase, timeS, durationS } = evaluator.poseOf(weights, { timeS: at });
  const head = {
    verb: evaluator.verb.name,
    channel: 1,
    flags: 0,
    version: 1,
    phase: phase % 1,
    timeS,
    error: 0,
    durationS,
  };
  head.timeS = timeS - Math.floor(phase) * durationS;
  const { looping } = evaluator.verb;
  return { dueMs: START_MS, head, weights: Float32Array.from(weights), rate: 1, loop: looping, ...more };
}

/** Largest difference of joint positions, m, with the roots' places where `roots` are given. */
function apart(evaluator: Evaluator, a: ArrayLike<number>, b: ArrayLike<number>): number {
  const [p, q] = [evaluator.positions(a), evaluator.positions(b)];
  return Math.max(...p.map((value, k) => Math.abs(value - (q[k] as number))));
}

describe("between records", () => {
  test("a walk of 20 s needs one record, and travels as the evaluator's", () => {
    const { weights } = walk.blend(WALKING);
    const recipe = new Recipe();
    recipe.take(record(walk, weights, 0));
    const out = new Float32Array(walk.poseLength);
    const rounded = Float32Array.from(weights);
    for (let k = 0; k <= 1200; k++) {
      expect(recipe.write(START_MS + (1000 * k) / 60, () => walk, out)).toBe(true);
      if (k % 100 === 0) expect(apart(walk, out, walk.poseOf(rounded, { timeS: k / 60 }).values)).toBeLessThan(2e-5);
    }
    expect(Math.hypot(out[0] as number, out[2] as number)).toBeGreaterThan(0.5);
  });

  test("key records change nothing", () => {
    const { weights } = walk.blend(WALKING);
    const [once, often] = [new Recipe(), new Recipe()];
    for (const recipe of [once, often]) recipe.take(record(walk, weights, 0));
    for (let s = 3; s < 12; s += 3) often.take(record(walk, weights, s, { dueMs: START_MS + 1000 * s }));
    const [a, b] = [new Float32Array(walk.poseLength), new Float32Array(walk.poseLength)];
    for (let k = 0; k <= 720; k++) {
      once.write(START_MS + (1000 * k) / 60, () => walk, a);
      often.write(START_MS + (1000 * k) / 60, () => walk, b);
      expect(apart(walk, a, b)).toBeLessThan(1e-5);
    }
  });

  test("speed and direction of play", () => {
    const { weights } = walk.blend(WALKING);
    const out = new Float32Array(walk.poseLength);
    const slow = new Recipe();
    slow.take(record(walk, weights, 0.2, { rate: -0.5 }));
    slow.write(START_MS, () => walk, out);
    const [x, z] = [out[0] as number, out[2] as number];
    for (let k = 1; k <= 60; k++) slow.write(START_MS + (1000 * k) / 60, () => walk, out);
    const { durationS } = walk.clock(weights);
    expect(slow.shown?.timeS).toBeCloseTo(0.2 - 0.5 + durationS, 4);
    const gone = Math.hypot((out[0] as number) - x, (out[2] as number) - z);
    expect(gone).toBeGreaterThan(0.5);
    expect(gone).toBeLessThan(0.8);
  });

  test("a paused one stands still, and a motion that does not loop ends", () => {
    const { weights } = punch.blend({ x: 0, y: 1.3, z: 0.8 });
    const out = new Float32Array(punch.poseLength);
    const paused = new Recipe();
    paused.take(record(punch, weights, 0.4, { rate: 0 }));
    paused.write(START_MS + 9_000, () => punch, out);
    expect(paused.shown?.timeS).toBeCloseTo(0.4, 5);
    const playing = new Recipe();
    playing.take(record(punch, weights, 0.4));
    playing.write(START_MS + 9_000, () => punch, out);
    expect(playing.shown?.phase).toBe(1);
  });

  test("a moving goal is interpolated", () => {
    const rows = [0, 1, 2].map((k) => punch.blend({ x: 0.1 * k, y: 1.3, z: 0.8 }).weights);
    const recipe = new Recipe();
    for (const [k, row] of rows.entries())
      recipe.take(record(punch, row, 0.2 + k / 30, { dueMs: START_MS + (1000 * k) / 30 }));
    const out = new Float32Array(punch.poseLength);
    let before: Float32Array | null = null;
    for (let k = 0; k <= 40; k++) {
      recipe.write(START_MS + (k * 1000) / 600, () => punch, out);
      if (before) expect(apart(punch, out, before)).toBeLessThan(0.02);
      before = out.slice();
    }
  });
});

describe("cuts", () => {
  test("a jump of the phase is cross-faded", () => {
    const { weights } = walk.blend(WALKING);
    const recipe = new Recipe();
    recipe.take(record(walk, weights, 0));
    recipe.take(record(walk, weights, 0.7, { dueMs: START_MS + 500 }));
    const out = new Float32Array(walk.poseLength);
    let before: Float32Array | null = null;
    for (let k = 0; k < 240; k++) {
      recipe.write(START_MS + (1000 * k) / 240, () => walk, out);
      if (before) expect(apart(walk, out, before)).toBeLessThan(0.05);
      before = out.slice();
    }
  });

  test("a new version is displayed once it is there", () => {
    const { weights } = walk.blend(WALKING);
    const recipe = new Recipe();
    recipe.take(record(walk, weights, 0));
    const newer = record(walk, weights, 0.5, { dueMs: START_MS + 500 });
    recipe.take({ ...newer, head: { ...newer.head, version: 2, flags: FLAGS.newVersion } });
    const out = new Float32Array(walk.poseLength);
    const only = (version: number) => (head: { version: number }) => (head.version <= version ? walk : null);
    expect(recipe.write(START_MS + 600, only(1), out)).toBe(true);
    expect(recipe.shown?.version).toBe(1);
    expect(recipe.write(START_MS + 700, only(2), out)).toBe(true);
    expect(recipe.shown?.version).toBe(2);
  });

  test("without its verb there is no pose", () => {
    const recipe = new Recipe();
    const out = new Float32Array(walk.poseLength);
    expect(recipe.write(START_MS, () => walk, out)).toBe(false);
    recipe.take(record(walk, walk.blend(WALKING).weights, 0));
    expect(recipe.write(START_MS, () => null, out)).toBe(false);
    expect(recipe.write(START_MS, () => punch, new Float32Array(punch.poseLength))).toBe(false);
  });
});
