"""Errors of streamed poses, measured again: forward kinematics of what arrived against the goals that were sent."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from adverb_client.records import ENCODINGS, Q32, Q48, decode_q32, decode_q48, record_dtype

from adverb_load.target import VerbInfo

if TYPE_CHECKING:
    from adverb_load.stream_client import Group

__all__ = ["AGREE_M", "Arrival", "Goal", "measure", "points_of"]

F64 = npt.NDArray[np.float64]

AGREE_M = {"f32": 1e-4, "q48": 2e-3, "q32": 5e-2}
"""Largest difference to the error of a record, metres, which the precision of the encoding explains."""

NEAR_M = {"f32": 2e-3, "q48": 4e-3, "q32": 5e-2}
"""Distance within which a pose shows a goal, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """A goal (D,) that was sent, and when it was scheduled; NaN for the first."""

    due_s: float
    point: F64


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A record of a measured channel: the channel's last goals, its verb, the arrival, the record's error."""

    goals: deque[Goal]
    verb: int
    now_s: float
    stated_m: float
    record: bytes


def points_of(records: Sequence[bytes], verb: VerbInfo, encoding: str) -> F64:
    """Positions (K, 3) of the effector in records of one layout."""
    number = ENCODINGS[encoding]
    rows = np.frombuffer(b"".join(records), record_dtype(number, verb.joints))
    if number == Q48:
        rotations = decode_q48(rows["words"])
    elif number == Q32:
        rotations = decode_q32(rows["words"])
    else:
        rotations = rows["rotations"]
    assert verb.effector is not None
    return verb.effector.points(rows["root"].astype(np.float64), rotations.astype(np.float64))


def measure(group: Group) -> None:
    """Measure the arrivals of a group, and forget them."""
    arrivals, group.arrivals = group.arrivals, []
    for number, verb in enumerate(group.verbs):
        rows = [row for row in arrivals if row.verb == number]
        if rows:
            for row, point in zip(
                rows, points_of([row.record for row in rows], verb, group.plan.encoding), strict=True
            ):
                _compare(group, row, point)


def _compare(group: Group, row: Arrival, point: F64) -> None:
    """Compare a pose with the last goals: it shows the nearest; the first that shows a goal ends its response time."""
    goals = list(row.goals)
    apart = [float(np.linalg.norm(goal.point - point)) for goal in goals]
    best = int(np.argmin(apart))
    error_m, encoding = apart[best], group.plan.encoding
    group.error.add(row.now_s, error_m)
    group.counts.add(row.now_s, "measured")
    if abs(error_m - row.stated_m) > AGREE_M[encoding]:
        group.counts.add(row.now_s, "disagree")
    if best and error_m < NEAR_M[encoding]:
        if goals[best].due_s <= row.now_s:
            group.response.add(goals[best].due_s, row.now_s - goals[best].due_s)
        for _ in range(best):  # superseded, or shown before
            row.goals.popleft()
