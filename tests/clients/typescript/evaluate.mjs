/** Compare poses of the evaluator with those of a server: random adverbs of all verbs, half of them refined. */

const { Client, Evaluator } = await import(process.env.ADVERB_CLIENT);
const [server, total] = [process.argv[2], Number(process.argv[3])];

let seed = 20_011;
/** Uniform in 0 to 1, the same in every run. */
function random() {
  seed = (Math.imul(seed, 1_103_515_245) + 12_345) >>> 0;
  return seed / 2 ** 32;
}

const client = new Client(server);
const verbs = await client.verbs();
const each = Math.ceil(total / verbs.length / 2);
const worst = {};
let poses = 0;
for (const { name } of verbs) {
  const evaluator = await Evaluator.load(await client.verbFile(name));
  const { adverbs, looping } = evaluator.verb;
  worst[name] = 0;
  for (const method of ["rbf", "refined"]) {
    const items = Array.from({ length: each }, () => ({
      // a fifth beyond the range on both sides, so that many are clamped
      adverbs: Object.fromEntries(adverbs.map(({ name, min, max }) => [name, min + (1.4 * random() - 0.2) * (max - min)])),
      ...(method === "rbf" ? { phase: random() * (looping ? 3 : 1) } : { time: 2 * random() }),
    }));
    const answers = await client.poses(name, { items, method, space: "global", plant: false });
    answers.forEach(({ positions, clamped }, k) => {
      const { adverbs: goal, phase, time } = items[k];
      const pose = evaluator.pose(goal, { method, ...(phase === undefined ? { timeS: time } : { phase }) });
      const found = evaluator.positions(pose.values);
      if (pose.clamped !== clamped) throw new Error(`${name}: clamped is ${pose.clamped} at ${JSON.stringify(goal)}`);
      positions.forEach((point, j) => {
        const distance = Math.hypot(...point.map((value, a) => value - found[3 * j + a]));
        worst[name] = Math.max(worst[name], distance);
      });
      poses++;
    });
  }
}
console.log(JSON.stringify({ poses, worst }));
