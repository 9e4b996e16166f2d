"""The course of a refinement: what is kept between the steps of a job, and how a step goes on from it.

With traffic two sets of search points take turns: the worst of all points, then the worst of those where the verb is
asked for. Where a step ends changes nothing: whose turn it is follows from what is kept.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from safetensors.numpy import load, save

from verbs.conventions import F64
from verbs.refine import Mark, Rules, resume
from verbs.verb import Basis, Chart, Verb

__all__ = ["MAX_CURVE", "SETS", "Course", "go_on"]

MAX_CURVE = 200
"""Points of an error curve; beyond, every second one is left out."""

SETS = ("uniform", "traffic")
"""Sets of search points, in the order of their turns; a course has the first, or both."""

_ARRAYS = ("centers", "radii", "radial", "poly")
_CHART = ("axes", "bend", "shift", "scale")


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A refinement so far.

    Parameters
    ----------
    basis : Basis
    marks : tuple of Mark
        One to a set of search points.
    curves : tuple of tuples
        One to a set: (pseudo-examples, mean error, largest error) after each of its steps, thinned to
        :data:`MAX_CURVE`; errors are shares of the diagonal.
    """

    basis: Basis
    marks: tuple[Mark, ...]
    curves: tuple[tuple[tuple[int, float, float], ...], ...]

    @classmethod
    def start(cls, verb: Verb, sets: int) -> Course:
        """Before the first step: the basis ``rbf``."""
        return cls(verb.bases["rbf"], (Mark(-1, np.inf, 0),) * sets, ((),) * sets)

    @property
    def steps(self) -> int:
        """Steps of the refinement taken so far."""
        return sum(max(mark.number, 0) for mark in self.marks)

    @property
    def stopped(self) -> str:
        """Why it is over; empty while it is not."""
        reasons = [mark.stopped for mark in self.marks]
        full = [reason for reason in reasons if reason.startswith("most")]
        return full[0] if full else reasons[0] if all(reasons) else ""

    @property
    def mark(self) -> Mark:
        """The marks as one."""
        return replace(self.marks[0], number=self.steps, stopped=self.stopped)

    def to_bytes(self) -> bytes:
        """As a safetensors file; the same course gives the same bytes."""
        basis, chart = self.basis, self.basis.chart
        arrays = {name: np.ascontiguousarray(getattr(basis, name)) for name in _ARRAYS}
        arrays |= {f"chart.{name}": np.ascontiguousarray(getattr(chart, name)) for name in _CHART}
        facts = {
            "kind": chart.kind, "kernel": basis.kernel, "degree": basis.degree, "condition": basis.condition,
            "marks": [asdict(mark) for mark in self.marks], "curves": self.curves,
        }  # fmt: skip
        return bytes(save(arrays, metadata={"course": json.dumps(facts, sort_keys=True)}))

    @classmethod
    def of_bytes(cls, data: bytes) -> Course:
        """Read what :meth:`to_bytes` wrote."""
        arrays = load(data)
        length = int.from_bytes(data[:8], "little")
        facts: dict[str, Any] = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["course"])
        chart = Chart(facts["kind"], *(arrays[f"chart.{name}"] for name in _CHART))
        basis = Basis(
            chart=chart, kernel=facts["kernel"], degree=facts["degree"], condition=facts["condition"],
            **{name: arrays[name] for name in _ARRAYS},
        )  # fmt: skip
        curves = tuple(tuple((int(n), mean, top) for n, mean, top in curve) for curve in facts["curves"])
        return cls(basis, tuple(Mark(**mark) for mark in facts["marks"]), curves)


def go_on(
    verb: Verb, course: Course, rules: Rules, sets: Sequence[F64 | None], *, enough: Callable[[], bool]
) -> Course:
    """Take steps from a course on until it is over, or there were enough; at least one.

    Parameters
    ----------
    verb : Verb
    course : Course
    rules : Rules
    sets : sequence of (B, D) float64 or None
        Search points; None stands for those that a refinement chooses by itself.
    enough : callable
        Asked after every step.
    """
    while not course.stopped:
        turn = _turn(course)
        for step in resume(verb, course.basis, course.marks[turn], rules, points=sets[turn]):
            row = (step.pseudo, step.after.mean, step.after.largest)
            course = Course(
                step.basis,
                _put(course.marks, turn, step.mark),
                _put(course.curves, turn, _longer(course.curves[turn], row)),
            )
            if enough():
                return course
            if course.stopped or _turn(course) != turn:
                break
    return course


def _turn(course: Course) -> int:
    """Index of the set whose turn it is: of those that are not done the one with the fewest steps."""
    left = [k for k, mark in enumerate(course.marks) if not mark.stopped]
    return min(left, key=lambda k: course.marks[k].number)


def _put(values: tuple[Any, ...], index: int, value: Any) -> tuple[Any, ...]:
    return (*values[:index], value, *values[index + 1 :])


def _longer(
    curve: tuple[tuple[int, float, float], ...], row: tuple[int, float, float]
) -> tuple[tuple[int, float, float], ...]:
    """A curve with one more point; where it would be too long, without the one that is least apart from its neighbours.

    Distances are ratios of numbers of pseudo-examples: where the error falls fast the curve stays dense.
    """
    longer = (*curve, row)
    if len(longer) <= MAX_CURVE:
        return longer
    places = np.log1p([point[0] for point in longer])
    crowded = 1 + int(np.argmin(places[2:] - places[:-2]))
    return longer[:crowded] + longer[crowded + 1 :]
