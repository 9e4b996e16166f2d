/** A figure whose weights are streamed, while its connection is resumed. */

import { readFileSync } from "node:fs";
import { beforeAll, expect, test } from "vitest";
import { Evaluator } from "../evaluator/evaluator.js";
import { Evaluators } from "../evaluator/evaluators.js";
import type { Opened } from "../schema.js";
import { layoutOf, RECORD_HEAD_BYTES, type RecordHead } from "../wire/decode.js";
import { Lateness } from "./clock.js";
import { FigureStream } from "./figure_stream.js";
import type { Motion } from "./motion.js";

const START_MS = 1_000_000;
const LATE_MS = 4;
const MOTION: Motion = {
  ...{ verb: "reach", method: "", names: ["x", "y", "z"], fps: 60, encoding: "weights" },
  ...{ playing: true, speed: 1, loop: true, seek: { serial: 0, phase: 0 } },
};

let reach: Evaluator;
let evaluators: Evaluators;

beforeAll(async () => {
  const content = Uint8Array.from(readFileSync(new URL("../../../../verbs/library/reach.verb", import.meta.url)));
  reach = await Evaluator.load(content);
  await new Promise<void>((done) => {
    evaluators = new Evaluators({ verbFile: async () => content.buffer }, done);
    evaluators.of("reach", 1);
  });
});

/** A figure that has had one record, due at START_MS. */
function started() {
  const lateness = new Lateness();
  const stream = new FigureStream(0, lateness, evaluators);
  stream.setTarget(1);
  const channel = stream.channels[0] as NonNullable<(typeof stream.channels)[0]>;
  channel.next(MOTION, [], 0, 0);
  const { name, skeleton } = reach.verb;
  stream.opened(channel, { verb: name, skeleton, joints: skeleton.names, method: "rbf" } as unknown as Opened);
  const { weights, phase, timeS, durationS } = reach.poseOf(reach.blend({ x: -0.3, y: 1.2, z: 0.45 }).weights);
  const layout = layoutOf("weights", skeleton.names.length, RECORD_HEAD_BYTES + 4 + 4 * weights.length);
  const view = new DataView(new ArrayBuffer(layout.recordBytes));
  view.setUint16(RECORD_HEAD_BYTES, weights.length, true);
  for (const [k, weight] of Array.from(weights).entries()) view.setFloat32(RECORD_HEAD_BYTES + 4 + 4 * k, weight, true);
  const head: RecordHead = { channel: 0, flags: 0, version: 1, phase, timeS, error: 0, durationS };
  lateness.add(START_MS + LATE_MS, START_MS);
  stream.take(view, 0, channel, layout, head);
  stream.commit(START_MS);
  return { stream, lateness };
}

test("its motion continues until the first message of the new connection", () => {
  const { stream, lateness } = started();
  const phases: number[] = [];
  for (let k = 0; k < 30; k++) {
    if (k === 15) lateness.clear();
    const drawn = stream.draw(START_MS + 100 + 10 * k, []);
    expect(drawn?.poses.every(Number.isFinite)).toBe(true);
    phases.push(drawn?.shown.phase ?? Number.NaN);
  }
  const steps = phases.slice(1).map((phase, k) => phase - (phases[k] as number));
  expect(Math.min(...steps)).toBeGreaterThan(0);
  expect(Math.max(...steps)).toBeLessThan(0.02);
});

test("one that was never displayed has no pose until that message", () => {
  const { stream, lateness } = started();
  lateness.clear();
  expect(stream.draw(START_MS + 100, [])).toBeNull();
  lateness.add(START_MS + 200, START_MS + 200 - LATE_MS);
  expect(stream.draw(START_MS + 210, [])?.poses.every(Number.isFinite)).toBe(true);
});
