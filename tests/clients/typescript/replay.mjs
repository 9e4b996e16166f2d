/** Replay a recorded stream: prints the joint positions of all records. */

import { readFileSync } from "node:fs";
import { join } from "node:path";

const client = await import(process.env.ADVERB_CLIENT);
const [recording, expected, root] = process.argv.slice(2);

const evaluators = new Map();
for (const { verb, version, file } of JSON.parse(readFileSync(expected, "utf8")).artifacts)
  evaluators.set(`${verb} ${version}`, await client.Evaluator.load(new Uint8Array(readFileSync(join(root, file)))));

const channels = new Map();
const found = [];

function applyText(text) {
  const message = JSON.parse(text);
  if (message.op === "opened") {
    const layout = client.layoutOf(message.encoding, message.joints.length, message.record_bytes);
    channels.set(message.channel, { layout, verb: message.verb, rig: client.rigOf(message.skeleton) });
  } else if (message.op === "version") {
    channels.get(message.channel).layout.recordBytes = message.record_bytes;
  }
}

function positionsOf(view, at, { layout, verb, rig }, head) {
  if (layout.encoding === "weights") {
    const evaluator = evaluators.get(`${verb} ${head.version}`);
    const weights = client.readWeights(view, at, layout);
    return evaluator.positions(evaluator.poseOf(weights, { phase: head.phase }).values);
  }
  const values = new Float32Array(client.poseLength(layout.joints));
  client.readPose(view, at, layout, values, 0);
  const positions = new Float64Array(3 * rig.joints);
  client.solve(rig, values, 0, positions, new Float64Array(4 * rig.joints));
  return positions;
}

function applyPoses(view) {
  const { records, sequence } = client.readMessageHead(view);
  const rows = [];
  let at = client.MESSAGE_HEAD_BYTES;
  for (let k = 0; k < records; k++) {
    const channel = channels.get(client.readChannel(view, at));
    const head = client.readRecordHead(view, at, channel.layout);
    rows.push({ channel: head.channel, version: head.version, positions: [...positionsOf(view, at, channel, head)] });
    at += channel.layout.recordBytes;
  }
  if (at !== view.byteLength) throw new Error("bytes after the last record");
  found.push({ sequence, records: rows });
}

const content = readFileSync(recording);
for (let at = 0; at < content.length; ) {
  const [kind, length] = [content.readUInt32LE(at), content.readUInt32LE(at + 4)];
  const message = new Uint8Array(content.subarray(at + 8, at + 8 + length));
  if (kind === 0) applyText(new TextDecoder().decode(message));
  else applyPoses(new DataView(message.buffer));
  at += 8 + length;
}
console.log(JSON.stringify(found));
