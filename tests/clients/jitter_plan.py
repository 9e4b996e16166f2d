"""Plans of frames with random lateness, and what the Python client's jitter buffer displays of them."""

from __future__ import annotations

import math

import numpy as np
from adverb_client import Delays, JitterBuffer, Lateness
from adverb_client.wire import Record


def schedule(seed, *, looping, weights=False, irregular=False):
    """Frames with random lateness, order and gaps, and times of display."""
    rng = np.random.default_rng(seed)
    steps, phase = [], 0.1
    for k in range(400):
        due = 1000.0 + k / 64
        phase = (phase + 0.013) % 1.0 if looping else min(phase + 0.003, 1.0)
        if rng.random() < 0.1 or 200 <= k < 212:  # a gap of 12 frames
            continue
        late = 0.002 + rng.exponential(0.004) + (0.03 if rng.random() < 0.05 else 0.0)
        rotations = rng.normal(size=(3, 4)) * 0.2 + [0.1, 0.2, 0.3, math.sin(k / 20) + 1.5]
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        values = rng.normal(size=7) if weights else np.append(rng.normal(size=3), rotations)
        steps.append((due - 990.0 + late, {
            "do": "push", "arrived": due - 990.0 + late, "due": due, "irregular": irregular, "version": 1 + k // 100,
            "flags": int(rng.integers(0, 4)) + (8 if phase == 1.0 and k % 3 else 0) + 16 * int(rng.integers(1, 15)),
            "phase": float(np.float32(phase)), "time": float(np.float32(2 * phase)), "duration": 2.0,
            "error": None if rng.random() < 0.2 else float(np.float32(rng.random())),
            "values": np.float32(values).tolist(),
        }))  # fmt: skip
    steps += [(now, {"do": "sample", "now": now}) for now in np.sort(rng.uniform(9.9, 17.0, 500)).tolist()]
    steps += [(12.5, {"do": "end"}), (14.0, {"do": "restart"})]
    steps.sort(key=lambda step: step[0])
    return {"interval_s": 1 / 64, "looping": looping, "weights": weights, "steps": [step for _, step in steps]}


def reference(plan):
    """Samples of the Python client's jitter buffer."""
    lateness = Lateness()
    buffer = JitterBuffer(lateness, plan["interval_s"], Delays())
    buffer.looping = plan["looping"]
    for step in plan["steps"]:
        if step["do"] == "push":
            lateness.add(step["arrived"], step["due"])
            buffer.push(step["due"], record(step, plan["weights"]), irregular=step["irregular"])
        elif step["do"] == "sample":
            yield buffer.sample(step["now"])
        else:
            getattr(buffer, step["do"])()


def record(step, weights):
    values = np.float32(step["values"])
    error = math.nan if step["error"] is None else step["error"]
    parts = (None, None, values) if weights else (values[:3], values[3:].reshape(-1, 4), None)
    return Record(0, step["flags"], step["version"], step["phase"], step["time"], error, step["duration"], *parts)
