/** Time of one pose, µs: the minimum over rounds. Prints JSON; `python -m tools.evaluator_bench` compares. */

import { readFileSync } from "node:fs";
import { Evaluator } from "../dist/index.js";

const ROUNDS = 30;
const POSES = 500;

function measure(run) {
  let best = Number.POSITIVE_INFINITY;
  for (let round = 0; round < ROUNDS; round++) {
    const start = performance.now();
    for (let k = 0; k < POSES; k++) run(k / POSES);
    best = Math.min(best, performance.now() - start);
  }
  return (1000 * best) / POSES;
}

const found = {};
for (const name of process.argv.slice(2).length > 0 ? process.argv.slice(2) : ["reach", "locomotion", "arm3"]) {
  const file = new URL(`../../../verbs/library/${name}.verb`, import.meta.url);
  const evaluator = await Evaluator.load(readFileSync(file));
  const middle = evaluator.verb.adverbs.map(({ min, max }) => (min + max) / 2);
  const { weights } = evaluator.blend(middle);
  const pose = evaluator.poseOf(weights).values;
  found[name] = {
    weights_us: measure(() => evaluator.blend(middle)),
    pose_us: measure((phase) => evaluator.poseOf(weights, { phase })),
    positions_us: measure(() => evaluator.positions(pose)),
  };
}
console.log(JSON.stringify(found));
