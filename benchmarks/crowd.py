"""Characters of one verb, stepped and written as records: cost of each part, by the size of the crowd.

Weights are what moving goals add to a step; pose is sorting, summing and normalising alone; pack is what placing the
pose and writing the record add; send is what the system takes for messages of up to 100 records of f32 over loopback,
sent by one compiled call. The bound is the arithmetic of the sums at the speed of a large matrix product.
"""

from __future__ import annotations

import os
import socket
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.timing import interleave
from service.packing import pack_step
from service.stream.kernels import DIRECT, Lines, send_messages
from service.wire import Layout, Targets
from verbs import Characters, Evaluator, Verb, library
from verbs.authoring.fit import build
from verbs.kernels.compile import direct, kernel
from verbs.kernels.crowd_pose import TILE, finish_single, share, sort_by_interval, sums

SIZES = (1, 60, 250, 1_000, 2_500, 10_000, 20_000)
TOGETHER = 100
"""Records of a message."""

STEP_S = 1 / 600
"""Short, so that no motion ends while it is measured."""
ENCODINGS = ("f32", "q48", "q32")
SQUARE = 1_024


@kernel
def _poses(slots, phases, state, weights, curves):
    """Poses in single precision that are written nowhere."""
    rows, intervals, mode, references = curves
    size, order, taps = slots.shape[0], np.empty(slots.shape[0], np.int64), np.empty(4)
    sort_by_interval(np.arange(size), phases, intervals, order)
    shares, tile = np.empty((TILE, 4 * weights.shape[2]), np.float32), np.empty((TILE, rows.shape[1]), np.float32)
    scales, at = np.empty(TILE * rows.shape[1] // 4, np.float32), np.empty(TILE, np.int64)
    for start in range(0, size, TILE):
        count = min(TILE, size - start)
        for k in range(count):
            b = order[start + k]
            own = weights[slots[b], state[slots[b]]["weights"]]
            at[k] = share(own, phases[b], intervals, taps, shares[k])
        sums(shares[:count], at[:count], rows, tile[:count])
        finish_single(tile[:count], scales, mode, references)


class Crowd:
    """So many characters of one verb, with a place for the records of each encoding."""

    def __init__(self, evaluator: Evaluator, count: int, rng: np.random.Generator) -> None:
        self.people, verb, chart = Characters(evaluator), evaluator.verb, evaluator.verb.domain.chart
        points = chart.points(verb.values)
        self.goals = [chart.adverbs(rng.dirichlet(np.full(len(points), 0.3), count) @ points) for _ in range(2)]
        phases, self.round = rng.uniform(0.0, 0.6, count), 0
        added = [self.people.add(row, phase=at, speed=0.1) for row, at in zip(self.goals[0], phases, strict=True)]
        self.slots = np.array(added)
        self.targets, self.words = {}, {}
        for encoding in ENCODINGS:
            layout = Layout(encoding, "local", "gltf", np.arange(len(verb.skeleton)), len(verb.examples))
            at = np.arange(count) * layout.words
            self.targets[encoding] = Targets.of([layout] * count, at, [0] * count)
            self.words[encoding] = np.zeros(count * layout.words, np.uint32)
        self.poses = direct(_poses)

    def move(self) -> None:
        """Give every character another goal."""
        self.round += 1
        self.people.aim_many(self.slots, self.goals[self.round % 2])

    def advance(self) -> None:
        """A step without poses."""
        self.people.advance(self.slots, STEP_S)

    def pose(self) -> None:
        """Poses without a step."""
        crowd = self.people.crowd
        self.poses(self.slots, crowd.state["phase"][self.slots], crowd.state, crowd.weights, self.people.curves)

    def pack(self, encoding: str) -> None:
        """A step and its records."""
        pack_step(self.people, self.slots, STEP_S, 1, self.targets[encoding], self.words[encoding])

    def move_and(self, act, *arguments) -> None:
        """Another goal for every character, and then an act."""
        self.move()
        act(*arguments)


def _send_us(count: int, record_bytes: int, rounds: int = 40) -> float:
    """Least CPU microseconds a record for messages of up to :data:`TOGETHER` records over loopback."""
    together = min(count, TOGETHER)
    messages, size = count // together, together * record_bytes
    words = np.zeros(messages * (size // 4 + 8), np.uint32)
    numbers = np.arange(messages)
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        pairs = []
        for _ in range(messages):
            left = stack.enter_context(socket.create_connection(listener.getsockname()))
            right = stack.enter_context(listener.accept()[0])
            left.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * size + 100_000)
            left.setblocking(False)
            pairs.append((left, right))
        descriptors = np.array([left.fileno() for left, _ in pairs])
        lines = Lines(np.full(messages, DIRECT), descriptors, np.zeros_like(numbers), np.zeros_like(numbers))
        starts, heads, sizes = numbers * (size // 4 + 8) + 4, np.full(messages, 4), np.full(messages, size)
        best, unsent = float("inf"), np.empty(messages, np.int64)
        for _ in range(rounds):
            started = time.thread_time()
            send_messages(words.view(np.uint8), words, starts, heads, sizes, numbers, lines, 0, unsent)
            best = min(best, time.thread_time() - started)
            if unsent.any():
                raise RuntimeError("a message did not fit into the buffer of its socket")
            for _, right in pairs:
                right.recv(size + 4, socket.MSG_WAITALL)
    return 1e6 * best / count


def _verb() -> Verb:
    """The captured reach, of 35 examples and 23 joints, if the recordings are there; else the built-in one."""
    folder = Path(os.environ.get("ADVERB_TEST_DATA", "../shared/data")) / "mocap" / "reach"
    return build(folder).verb if folder.is_dir() else library.load("reach")


def _bound_us(verb: Verb, rng: np.random.Generator) -> float:
    """Microseconds for the sums of one pose, at the speed of a large single-precision matrix product."""
    square = rng.normal(size=(SQUARE, SQUARE)).astype(np.float32)
    out = np.zeros_like(square)
    seconds = interleave({"sgemm": lambda: np.dot(square, square, out=out)}, rounds=40)["sgemm"]
    flops = 2 * 4 * len(verb.examples) * verb.curves.shape[2]
    return 1e6 * flops / (2 * SQUARE**3 / seconds)


def main() -> None:
    """Print one table."""
    verb, rng = _verb(), np.random.default_rng(0)
    evaluator, bound = Evaluator(verb), _bound_us(verb, rng)
    print(f"crowd: {verb.name}, {len(verb.examples)} examples, {len(verb.skeleton)} joints; µs a character")
    print(f"  bound of a pose by sgemm: {bound:.3f} µs")
    heads = ("weights", "step", "pose", "pack f32", "q48", "q32", "at rest", "moving", "send f32", "bound / pose")
    print(f"  {'characters':>10}" + "".join(f"{head:>13}" for head in heads))
    for count in SIZES:
        row = _row(Crowd(evaluator, count, rng), count)
        print(f"  {count:>10,}" + "".join(f"{value:>13.3f}" for value in row) + f"{bound / row[2]:>13.2f}")


def _row(crowd: Crowd, count: int) -> list[float]:
    """Microseconds a character, as in the table's heads."""
    rounds = int(np.clip(20_000 // count, 8, 300))
    tasks = {"step": crowd.advance, "pose": crowd.pose}
    tasks |= {encoding: partial(crowd.pack, encoding) for encoding in ENCODINGS}
    best = interleave(tasks, rounds=rounds)
    tasks = {"step": partial(crowd.move_and, crowd.advance), "f32": partial(crowd.move_and, crowd.pack, "f32")}
    moving = interleave(tasks, rounds=max(rounds // 3, 6))
    packed = [best[encoding] - best["step"] - best["pose"] for encoding in ENCODINGS]
    row = (moving["step"] - best["step"], best["step"], best["pose"], *packed, best["f32"], moving["f32"])
    sent = _send_us(count, 4 * len(crowd.words["f32"]) // count)
    return [*(1e6 * seconds / count for seconds in row), sent]


if __name__ == "__main__":
    main()
