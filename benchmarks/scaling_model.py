"""A model of streaming servers: CPU by what is sent and received, ticks by simulation, and sizes that follow.

The CPU time of a server process is a sum of rates times costs (:data:`COSTS`), which :func:`fit` finds from measured
loads. :func:`simulate` plays the ticks of one process with these costs: preparation ahead of the due time, messages one
after the other, ticks that are skipped where time runs out, and a reader on another core. Everything else is
arithmetic. ``docs/scaling.md`` states the assumptions by the numbers that stand here as A1, A2, ….
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from adverb_client.records import ENCODINGS, record_dtype
from adverb_client.wire import MESSAGE_HEADER
from scipy.optimize import nnls
from scipy.stats import poisson

Numbers = npt.NDArray[np.float64]

FPS = 60
COSTS = ("process", "message", *ENCODINGS, "block", "moving", "frame", "row")
"""Of a second of a process, a message, a pose at rest in each encoding, a block of poses that are summed together, a
pose whose goal moves (in addition), a WebSocket frame received, and a row of adverbs in one."""

BLOCK = 4
"""Poses of one knot interval that are summed together, as in ``verbs/kernels/crowd_pose.py``."""

READER_COSTS = ("message", "byte", "frame")

AHEAD_S = 0.001
"""Time between the end of a preparation and its due time, as in ``service/stream/ticks.py``."""

SEGMENT, ON_WIRE = 1_448, 1_538
"""Payload of a TCP segment, and its bytes on Ethernet, preamble and gap included (A7)."""


@dataclass(frozen=True, slots=True)
class Group:
    """Sockets of one kind.

    Parameters
    ----------
    sockets, channels : int
        Number of sockets, and of characters of each.
    encoding : str
    steer_hz : float
        Rate of new goals of each character; 0: at rest.
    bulk : bool
        Whether one frame has the goals of all characters of a socket.
    """

    sockets: int
    channels: int
    encoding: str = "f32"
    steer_hz: float = 0.0
    bulk: bool = True

    @property
    def characters(self) -> int:
        """Number of characters."""
        return self.sockets * self.channels


@dataclass(frozen=True, slots=True)
class Shape:
    """What sizes depend on: joints, examples and knot intervals of a verb."""

    joints: int
    examples: int
    intervals: int

    def record_bytes(self, encoding: str) -> int:
        """Length of a record, padding included."""
        size = record_dtype(ENCODINGS[encoding], self.examples if encoding == "weights" else self.joints).itemsize
        return size + -size % 4

    def message_bytes(self, group: Group) -> int:
        """Length of a pose message without its WebSocket head."""
        return MESSAGE_HEADER.size + group.channels * self.record_bytes(group.encoding)

    def wire_bytes(self, group: Group) -> float:
        """Bytes of a pose message on Ethernet (A7)."""
        size = self.message_bytes(group)
        whole = size + (2 if size < 126 else 4 if size < 65_536 else 10)
        return whole + (ON_WIRE - SEGMENT) * math.ceil(whole / SEGMENT)


def rates(groups: Sequence[Group], shape: Shape) -> dict[str, float]:
    """Rates per second of :data:`COSTS` (A2, A3)."""
    found = dict.fromkeys(COSTS, 0.0)
    found["process"] = 1.0
    for group in groups:
        found["message"] += group.sockets * FPS
        found[group.encoding] += group.characters * FPS
        if group.steer_hz:
            found["moving"] += group.characters * FPS
            found["row"] += group.characters * group.steer_hz
            found["frame"] += (group.sockets if group.bulk else group.characters) * group.steer_hz
    posed = sum(group.characters for group in groups if group.encoding != "weights")
    found["block"] = FPS * blocks(posed, shape.intervals)
    return found


def blocks(characters: int, intervals: int) -> float:
    """Mean number of blocks of a tick whose phases are drawn evenly (A3)."""
    mean = characters / intervals
    numbers = np.arange(math.ceil(mean + 12.0 * math.sqrt(mean)) + 12)
    return float(intervals * (poisson.pmf(numbers, mean) @ np.ceil(numbers / BLOCK)))


def reader_rates(groups: Sequence[Group], shape: Shape) -> dict[str, float]:
    """Rates per second of :data:`READER_COSTS`."""
    return {
        "message": float(sum(group.sockets * FPS for group in groups)),
        "byte": float(sum(group.sockets * FPS * shape.message_bytes(group) for group in groups)),
        "frame": rates(groups, shape)["frame"],
    }


def fit(points: Sequence[tuple[Mapping[str, float], float]]) -> dict[str, float]:
    """Costs ≥ 0, seconds, for which the relative errors of all points are least.

    Parameters
    ----------
    points : list of (rates, CPU seconds per second)
    """
    names = list(points[0][0])
    matrix = np.array([[row[name] / cpu for name in names] for row, cpu in points])
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-30)
    found, _ = nnls(matrix / scale, np.ones(len(points)))
    return dict(zip(names, (found / scale).tolist(), strict=True))


def total(found: Mapping[str, float], costs: Mapping[str, float]) -> float:
    """CPU seconds per second."""
    return sum(rate * costs[name] for name, rate in found.items())


@dataclass(frozen=True, slots=True)
class Model:
    """A measured machine.

    Parameters
    ----------
    shape : Shape
    costs, reader : dict
        Seconds, by :data:`COSTS` and :data:`READER_COSTS`.
    delays_s : sequence of (share, seconds)
        Quantiles of the lateness of a single character: what the machine adds to every tick (A5).
    """

    shape: Shape
    costs: Mapping[str, float]
    reader: Mapping[str, float]
    delays_s: Sequence[tuple[float, float]] = ((0.0, 0.0), (1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Predicted:
    """What a simulation gives.

    Parameters
    ----------
    cpu : float
        Share of a core.
    delivered : float
        Share of the messages that are due.
    payload : float
        Bytes of pose messages per second, WebSocket heads not included.
    late_ms : list of (p50, p99)
        Of each group.
    """

    cpu: float
    delivered: float
    payload: float
    late_ms: list[tuple[float, float]]


@dataclass(slots=True)
class _Ticks:
    """Due times of the ticks that are sent, and when their preparation has ended."""

    due_s: list[float] = field(default_factory=list)
    skipped: int = 0


def simulate(
    groups: Sequence[Group], model: Model, *, kept: float = 0.0, seconds: float = 20.0, seed: int = 1
) -> Predicted:
    """Play the ticks of one server process on one core (A4).

    The event loop takes its share of the core, and other programs ``kept`` of it, so the engine's work takes longer. A
    tick is prepared before it is due, by the estimate of the server. If its preparation starts too late, whole ticks
    are skipped.
    """
    rng = np.random.default_rng(seed)
    work = rates(groups, model.shape)
    spent = {name: rate * model.costs[name] for name, rate in work.items()}
    loop = spent["process"] + spent["frame"] + spent["row"]
    slower = 1.0 / max(1.0 - loop - kept, 0.02)
    send_s = slower * model.costs["message"]
    prepare_s = slower * (sum(spent.values()) - loop - spent["message"]) / FPS
    kinds = rng.permutation(np.repeat(np.arange(len(groups)), [group.sockets for group in groups]))
    sizes = np.array([model.shape.message_bytes(group) for group in groups])
    read_s = np.array(model.reader["message"] + model.reader["byte"] * sizes)[kinds]
    shares, delays_s = np.array(model.delays_s).T
    offsets = send_s * np.arange(1, len(kinds) + 1)
    ticks, late, free_s, read_free_s, number = 0, [], 0.0, 0.0, 0
    while number < seconds * FPS:
        number += 1
        start_s = max(free_s, number / FPS - AHEAD_S - prepare_s)
        number += max(int((start_s - number / FPS) * FPS), 0)
        due_s = number / FPS
        sent_s = max(start_s + prepare_s, due_s) + np.interp(rng.uniform(), shares, delays_s) + offsets
        free_s = float(sent_s[-1])
        late.append(_read(sent_s, read_s, read_free_s) - due_s)
        read_free_s = float(late[-1][-1] + due_s + read_s[-1])
        ticks += 1
    lateness = np.array(late)
    delivered = ticks / number
    found = [np.quantile(1e3 * lateness[:, kinds == kind], [0.5, 0.99]).tolist() for kind in range(len(groups))]
    payload = FPS * delivered * float(sum(group.sockets * size for group, size in zip(groups, sizes, strict=True)))
    cpu = min(loop + delivered * (sum(spent.values()) - loop), 1.0)
    return Predicted(cpu, delivered, payload, [(p50, p99) for p50, p99 in found])


def _read(sent_s: Numbers, read_s: Numbers, free_s: float) -> Numbers:
    """When a reader that handles one message after the other begins with each."""
    before = np.concatenate([[0.0], np.cumsum(read_s)[:-1]])
    ready = np.maximum(sent_s, free_s)
    return np.asarray(np.maximum.accumulate(ready - before) + before)


# ── sizes ─────────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, slots=True)
class Plan:
    """What is chosen, not measured; every value is an example (A6, A8, A9, A10, A14)."""

    channels: int = 100
    moving: float = 0.3
    steer_hz: float = 10.0
    headroom: float = 0.7
    core_hour: float = 0.04
    gigabyte: float = 0.05
    host_cores: int = 32
    host_gbit_s: float = 25.0
    kept_alive_hz: float = 1.0

    def groups(self, sockets: int, encoding: str) -> list[Group]:
        """Sockets of which a share is steered."""
        moving = round(self.moving * sockets)
        steered = Group(moving, self.channels, encoding, self.steer_hz)
        return [group for group in (replace(steered, sockets=sockets - moving, steer_hz=0.0), steered) if group.sockets]


def holds(found: Predicted) -> bool:
    """Whether 99 % of the messages arrive, 99 % of them within a frame (A8)."""
    return found.delivered >= 0.99 and all(p99 <= 1e3 / FPS for _, p99 in found.late_ms)


def capacity(plan: Plan, encoding: str, model: Model) -> tuple[int, float]:
    """Largest number of characters of one process that holds, and its share of a core; clients read at once (A16)."""
    model = replace(model, reader=dict.fromkeys(READER_COSTS, 0.0))
    low, high = 0, 8
    while holds(simulate(plan.groups(high, encoding), model, seconds=4.0)):
        low, high = high, 2 * high
    while high - low > max(low // 50, 1):
        middle = (low + high) // 2
        if holds(simulate(plan.groups(middle, encoding), model, seconds=4.0)):
            low = middle
        else:
            high = middle
    return low * plan.channels, simulate(plan.groups(low, encoding), model, seconds=4.0).cpu if low else 0.0


@dataclass(frozen=True, slots=True)
class Size:
    """A row of the sizing table; see :func:`size`."""

    encoding: str
    characters: int
    cores: int
    gbit_s: float
    memory_gb: float
    cores_per_hour: float
    traffic_per_hour: float


def size(plan: Plan, encoding: str, characters: int, each: int, kib: float, model: Model) -> Size:
    """Cores, bandwidth, memory and cost.

    Parameters
    ----------
    plan : Plan
    encoding : str
    characters : int
    each : int
        Capacity of a process.
    kib : float
        Memory of a character.
    model : Model
    """
    cores = math.ceil(characters / (plan.headroom * each))
    message = model.shape.wire_bytes(Group(1, plan.channels, encoding))
    bytes_s = characters / plan.channels * FPS * message
    return _priced(plan, encoding, characters, cores, bytes_s, kib)


def recipe(plan: Plan, characters: int, kib: float, model: Model) -> Size:
    """An estimate of a future encoding: weights are sent while they change, and once a second otherwise (A11)."""
    moving = plan.moving * FPS + (1.0 - plan.moving) * plan.kept_alive_hz
    message = model.shape.wire_bytes(Group(1, plan.channels, "weights")) / plan.channels
    per_pose = model.costs["weights"] + model.costs["message"] / plan.channels
    cpu = moving * per_pose + plan.moving * (FPS * model.costs["moving"] + plan.steer_hz * model.costs["row"])
    cores = math.ceil(characters * cpu / plan.headroom)
    return _priced(plan, "recipe", characters, cores, characters * moving * message, kib)


def _priced(plan: Plan, encoding: str, characters: int, cores: int, bytes_s: float, kib: float) -> Size:
    traffic = plan.gigabyte * 3_600.0 * bytes_s * 1e-9
    memory = characters * kib * 1_024.0 * 1e-9
    return Size(encoding, characters, cores, 8e-9 * bytes_s, memory, plan.core_hour * cores, traffic)


def rate_of_budget(kbps: float, channels: int, record: int) -> float:
    """Mean frames per second of a character under a byte budget of its socket (A12)."""
    left = kbps * 125.0 - FPS * (MESSAGE_HEADER.size + 10)
    return min(float(FPS), max(left, 0.0) / (channels * record))
