// Load for k6: poses by REST at a constant arrival rate (open loop), and streams whose binary messages are decoded.
//
//   k6 run -e URL=http://127.0.0.1:8000 -e RATE=100 -e SOCKETS=20 -e SECONDS=30 clients/load/k6.js
//
// Effectors are computed here from the poses that arrive, and compared with the goals. The bytes are those of
// docs/wire.md. k6 counts requests that it could not start in time as dropped_iterations.

import http from 'k6/http';
import { check, fail } from 'k6';
import { Counter, Trend } from 'k6/metrics';
import { WebSocket } from 'k6/experimental/websockets';

const URL = __ENV.URL || 'http://127.0.0.1:8000';
const VERB = __ENV.VERB || 'reach';
const RATE = Number(__ENV.RATE || 50);
const SOCKETS = Number(__ENV.SOCKETS || 10);
const FPS = Number(__ENV.FPS || 60);
const SECONDS = Number(__ENV.SECONDS || 10);
const KEY = __ENV.ADVERB_KEY || '';

const MESSAGE_HEAD = 20;
const RECORD_HEAD = 24;
const CLAMPED = 1;
const AGREE_M = 1e-4; // poses are float32

const HEADERS = KEY ? { Authorization: `Bearer ${KEY}` } : {};

const errors = new Trend('adverb_error_um');
const streamErrors = new Trend('adverb_stream_error_um');
const lateness = new Trend('adverb_stream_lateness', true);
const frames = new Counter('adverb_stream_frames');
const dropped = new Counter('adverb_stream_dropped');
const gaps = new Counter('adverb_stream_gaps');

export const options = {
  scenarios: {
    poses: {
      executor: 'constant-arrival-rate',
      exec: 'pose',
      rate: RATE,
      timeUnit: '1s',
      duration: `${SECONDS}s`,
      preAllocatedVUs: 20,
      maxVUs: 200,
    },
    streams: {
      executor: 'per-vu-iterations',
      exec: 'stream',
      vus: SOCKETS,
      iterations: 1,
      maxDuration: `${SECONDS + 20}s`,
    },
  },
  thresholds: {
    checks: ['rate==1'],
    adverb_stream_gaps: ['count==0'],
  },
  summaryTrendStats: ['min', 'med', 'p(90)', 'p(99)', 'p(99.9)', 'max'],
};

// The verb's effector: joints from the root to its parent, offsets of the next joint in each, and its phase.
export function setup() {
  const response = http.get(`${URL}/v1/verbs/${encodeURIComponent(VERB)}`, { headers: HEADERS });
  if (response.status !== 200) {
    fail(`GET /v1/verbs/${VERB}: status ${response.status} ${response.body}`);
  }
  const verb = response.json();
  const { measure, skeleton } = verb;
  if (measure.kind !== 'joint_position' || measure.adverbs.join() !== 'x,y,z') {
    fail(`${VERB} is not measured by the position of a joint`);
  }
  const path = [skeleton.names.indexOf(measure.effector)];
  while (skeleton.parents[path[0]] >= 0) {
    path.unshift(skeleton.parents[path[0]]);
  }
  return {
    joints: skeleton.names.length,
    chain: path.slice(0, -1),
    offsets: path.slice(1).map((joint) => skeleton.offsets[joint]),
    phase: verb.keytime_phases[verb.keytime_names.indexOf(measure.keytime)],
    goals: verb.examples.map((example) => [example.adverbs.x, example.adverbs.y, example.adverbs.z]),
  };
}

export function pose(verb) {
  const goal = goalOf(verb);
  const response = http.post(
    `${URL}/v1/verbs/${encodeURIComponent(VERB)}/pose`,
    JSON.stringify({ adverbs: named(goal), phase: verb.phase }),
    {
      headers: Object.assign({ 'Content-Type': 'application/json', Accept: 'application/octet-stream' }, HEADERS),
      responseType: 'binary',
    },
  );
  const good = check(response, {
    'the response is a record': (r) => r.status === 200 && r.body.byteLength === RECORD_HEAD + 12 + 16 * verb.joints,
  });
  if (good) {
    const record = recordOf(new DataView(response.body), 0);
    const error = distance(effector(verb, new DataView(response.body), RECORD_HEAD), goal);
    errors.add(1e6 * error);
    check(error, { 'the pose is where its error states': (e) => record.clamped || Math.abs(e - record.error) < AGREE_M });
  }
}

export function stream(verb) {
  const params = { headers: HEADERS };
  const socket = new WebSocket(`${URL.replace(/^http/, 'ws')}/v1/stream`, 'adverb.v1', params);
  const goal = goalOf(verb);
  const last = { sequence: 0, dropped: 0, transit: Infinity };
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => {
    socket.send(
      JSON.stringify({
        op: 'open', channel: 0, verb: VERB, adverbs: named(goal), fps: FPS, phase: verb.phase, play: false, half_life: 0,
      }),
    );
    setTimeout(() => socket.close(), SECONDS * 1000);
  };
  socket.onmessage = (event) => {
    if (typeof event.data === 'string') {
      const message = JSON.parse(event.data);
      check(message, { 'no error message': (m) => m.op !== 'error' });
      return;
    }
    message(verb, goal, last, new DataView(event.data));
  };
  socket.onerror = (event) => check(event, { 'the stream is open': () => false });
}

// One pose message: its header, and the only record.
function message(verb, goal, last, view) {
  const now = Date.now();
  const good = check(view, {
    'the message is a pose message': (v) => v.getUint8(0) === 1 && v.getUint8(1) === 1 && v.getUint16(2, true) === 1,
  });
  if (!good) {
    return;
  }
  const sequence = view.getUint32(4, true);
  const due = view.getUint32(8, true) / 1e6 + view.getUint32(12, true) * 4294.967296; // ms
  const lost = view.getUint32(16, true);
  frames.add(1);
  dropped.add(lost - last.dropped);
  gaps.add(Math.max(0, sequence - last.sequence - 1 - (lost - last.dropped)));
  last.transit = Math.min(last.transit, now - due); // the clocks differ; lateness is relative to the earliest message
  lateness.add(now - due - last.transit);
  last.sequence = sequence;
  last.dropped = lost;
  const record = recordOf(view, MESSAGE_HEAD);
  const error = distance(effector(verb, view, MESSAGE_HEAD + RECORD_HEAD), goal);
  streamErrors.add(1e6 * error);
  check(error, { 'the frame is where its error states': (e) => record.clamped || Math.abs(e - record.error) < AGREE_M });
}

function recordOf(view, at) {
  return { clamped: (view.getUint8(at + 3) & CLAMPED) !== 0, error: view.getFloat32(at + 16, true) };
}

function goalOf(verb) {
  return verb.goals[Math.floor(Math.random() * verb.goals.length)];
}

function named(goal) {
  return { x: goal[0], y: goal[1], z: goal[2] };
}

// Position of the effector in a payload of encoding f32: root x, y, z, then x, y, z, w of every joint.
function effector(verb, view, at) {
  const number = (k) => view.getFloat32(at + 4 * k, true);
  let position = [number(0), number(1), number(2)];
  let rotation = [0, 0, 0, 1];
  for (let k = 0; k < verb.chain.length; k += 1) {
    const first = 3 + 4 * verb.chain[k];
    rotation = multiply(rotation, [number(first), number(first + 1), number(first + 2), number(first + 3)]);
    const step = rotate(rotation, verb.offsets[k]);
    position = position.map((value, axis) => value + step[axis]);
  }
  return position;
}

function multiply(a, b) {
  return [
    a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
    a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
    a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
    a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
  ];
}

function rotate(q, v) {
  const t = cross(q, v).map((value) => 2 * value);
  const u = cross(q, t);
  return v.map((value, axis) => value + q[3] * t[axis] + u[axis]);
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}
