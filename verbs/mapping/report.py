"""A mapping in figures: effector and feet over motions at goals all over the domain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from verbs.domain import random_points
from verbs.mapping.mapper import Figures, Mapper
from verbs.mapping.plan import Row
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator

__all__ = ["REACHED_M", "Report", "measure", "rows_as_dicts"]

RATE_HZ = 60.0
"""Frames per second."""

REACHED_M = 1e-3
"""Distance up to which a goal is reached, metres."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Report:
    """Figures of whole motions at goals inside the domain.

    Parameters
    ----------
    goals : int
    reached : int or None
        How many are reached within :data:`REACHED_M`; None without an effector.
    median, worst : Figures
    """

    goals: int
    reached: int | None
    median: Figures
    worst: Figures

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {
            "goals": self.goals, "reached": self.reached, "median": self.median.as_dict(),
            "worst": self.worst.as_dict(),
        }  # fmt: skip


def measure(mapper: Mapper, evaluator: Evaluator, *, goals: int = 27, seed: int = 1, progress: Progress) -> Report:
    """Map motions at random goals inside the domain of a verb; two cycles of a loop."""
    rows = random_points(evaluator.verb, np.random.default_rng(seed), goals)
    cycles = 2 if evaluator.verb.looping else 1
    found: list[Figures] = []
    for k, row in enumerate(rows):
        poses = sequence.sequence(evaluator, row[None], RATE_HZ, cycles=cycles)
        found.append(mapper.sequence(evaluator, poses, RATE_HZ)[1])
        progress("goals", k + 1, len(rows))
    reached = [one.effector_m for one in found if one.effector_m is not None]
    count = sum(value <= REACHED_M for value in reached) if reached else None
    return Report(len(rows), count, _over(found, np.median), _over(found, np.max))


def _over(found: list[Figures], statistic: Callable[[list[float]], Any]) -> Figures:
    columns = zip(*((one.effector_m, one.foot_height_m, one.foot_slide_m) for one in found), strict=True)
    values = [[value for value in column if value is not None] for column in columns]
    return Figures(*(float(statistic(column)) if column else None for column in values))


def rows_as_dicts(mapper: Mapper) -> list[dict[str, Any]]:
    """Joints of the target in their order with what moves each; ``source`` is None of those that nothing moves."""
    names = mapper.source.rig.skeleton.names
    driven = {row.target: row for row in mapper.tables.rows}
    rows = []
    for joint, name in enumerate(mapper.skeleton.names):
        row = driven.get(joint)
        rows.append({"target": name, "bone": row.bone if row else "", **_origin(row, names)})
    return rows


def _origin(row: Row | None, names: tuple[str, ...]) -> dict[str, Any]:
    if row is None:
        return {"source": None, "second": None, "share": 0.0, "how": "rest"}
    how = "given" if row.given else "spread" if row.bone in ("spine", "neck") else "bone" if row.bone else "name"
    second = names[row.second] if row.share > 0.0 else None
    return {"source": names[row.first], "second": second, "share": round(row.share, 4), "how": how}
