/**
 * A program that uses the built package: connects, opens a figure, and prints what happens, a JSON object a line.
 * Commands are read from standard input, a JSON object a line.
 */

import { createInterface } from "node:readline";

const { connect } = await import(process.env.ADVERB_CLIENT);
const { server, verb, key = null, timeoutMs = 10_000, options = {} } = JSON.parse(process.argv[2]);
const POSE_MS = 20;

const print = (event, fields = {}) => process.stdout.write(`${JSON.stringify({ event, ...fields })}\n`);
const failed = ({ name, code, status, detail, known }) => print("failed", { name, code, status, detail, known });

async function run() {
  const stream = await connect(server, { key, timeoutMs });
  print("connected");
  for (const name of ["connection", "unauthenticated", "drain"]) stream.on(name, (event) => print(name, event));
  stream.on("version", ({ version }) => print("version", { version }));
  stream.on("error", failed);
  const figure = await stream.open(verb, options);
  print("opened", { version: figure.info.version, goal: figure.goal });
  let shown = 0;
  setInterval(() => {
    const pose = figure.pose();
    if (!pose) return;
    const { values: _, skeleton: __, ...head } = pose;
    print("pose", { ...head, hand: [...figure.positions(pose).slice(-3)], number: ++shown, late: figure.delayMs });
  }, POSE_MS);
  const commands = {
    set: (settings) => figure.set(settings),
    switch: ({ verb: name }) => figure.switch(name).then(() => print("switched"), failed),
    key: ({ key: other }) => stream.setKey(other),
    stats: () => print("stats", stream.stats()),
    close: () => {
      figure.close();
      stream.close();
      print("closed", { connection: stream.connection });
      process.exit(0);
    },
  };
  for await (const line of createInterface({ input: process.stdin })) {
    const { command, ...fields } = JSON.parse(line);
    commands[command](fields);
  }
}

run().catch((err) => {
  failed(err);
  process.exit(1);
});
