"""Checkpoint of a refinement: its state between the steps of a job, and how a step resumes from it.

With recorded usage two sets of search points alternate: uniform points, and points sampled from the usage. The next set
follows from the checkpoint alone, so the result does not depend on where a step ends.
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

__all__ = ["MAX_CURVE", "SETS", "Checkpoint", "decode", "encode", "resume_refinement"]

MAX_CURVE = 200
"""Largest number of points of an error curve; further ones replace the most crowded point."""

SETS = ("uniform", "traffic")
"""Sets of search points, in their order; a checkpoint has the first, or both."""

_ARRAYS = ("centers", "radii", "radial", "poly")
_CHART = ("axes", "bend", "shift", "scale")


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """State of a refinement between two steps.

    Parameters
    ----------
    basis : Basis
    marks : tuple of Mark
        One per set of search points.
    curves : tuple of tuples
        One per set: (pseudo-examples, mean error, largest error) after each of its steps, thinned to
        :data:`MAX_CURVE`; errors are shares of the diagonal.
    """

    basis: Basis
    marks: tuple[Mark, ...]
    curves: tuple[tuple[tuple[int, float, float], ...], ...]

    @classmethod
    def start(cls, verb: Verb, sets: int) -> Checkpoint:
        """Checkpoint before the first step, with the basis ``rbf``."""
        return cls(verb.bases["rbf"], (Mark(-1, np.inf, 0),) * sets, ((),) * sets)

    @property
    def steps(self) -> int:
        """Number of steps so far."""
        return sum(max(mark.number, 0) for mark in self.marks)

    @property
    def stopped(self) -> str:
        """Why the refinement is finished; empty while it is not."""
        reasons = [mark.stopped for mark in self.marks]
        full = [reason for reason in reasons if reason.startswith("most")]
        return full[0] if full else reasons[0] if all(reasons) else ""

    @property
    def mark(self) -> Mark:
        """The marks of all sets as one."""
        return replace(self.marks[0], number=self.steps, stopped=self.stopped)

    def to_bytes(self) -> bytes:
        """Encode as a safetensors file; equal checkpoints give equal bytes."""
        return encode(self.basis, {"marks": [asdict(mark) for mark in self.marks], "curves": self.curves})

    @classmethod
    def from_bytes(cls, data: bytes) -> Checkpoint:
        """Decode the result of :meth:`to_bytes`."""
        basis, facts = decode(data)
        curves = tuple(tuple((int(n), mean, top) for n, mean, top in curve) for curve in facts["curves"])
        return cls(basis, tuple(Mark(**mark) for mark in facts["marks"]), curves)


def encode(basis: Basis, facts: dict[str, Any]) -> bytes:
    """A basis and further facts, JSON values, as a safetensors file; the same values give the same bytes."""
    chart = basis.chart
    arrays = {name: np.ascontiguousarray(getattr(basis, name)) for name in _ARRAYS}
    arrays |= {f"chart.{name}": np.ascontiguousarray(getattr(chart, name)) for name in _CHART}
    own = {"kind": chart.kind, "kernel": basis.radial_basis, "degree": basis.degree, "condition": basis.condition}
    return bytes(save(arrays, metadata={"checkpoint": json.dumps(facts | own, sort_keys=True)}))


def decode(data: bytes) -> tuple[Basis, dict[str, Any]]:
    """Basis and facts of :func:`encode`."""
    arrays = load(data)
    length = int.from_bytes(data[:8], "little")
    facts: dict[str, Any] = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["checkpoint"])
    chart = Chart(facts["kind"], *(arrays[f"chart.{name}"] for name in _CHART))
    basis = Basis(
        chart=chart, radial_basis=facts["kernel"], degree=facts["degree"], condition=facts["condition"],
        **{name: arrays[name] for name in _ARRAYS},
    )  # fmt: skip
    return basis, facts


def resume_refinement(
    verb: Verb, checkpoint: Checkpoint, rules: Rules, sets: Sequence[F64 | None], *, should_stop: Callable[[], bool]
) -> Checkpoint:
    """Refine from a checkpoint until finished or ``should_stop()``; at least one step.

    Parameters
    ----------
    verb : Verb
    checkpoint : Checkpoint
    rules : Rules
    sets : sequence of (B, D) float64 or None
        Search points; None for those that the refinement chooses itself.
    should_stop : callable
        Called after every step.
    """
    while not checkpoint.stopped:
        active = _next_set(checkpoint)
        for step in resume(verb, checkpoint.basis, checkpoint.marks[active], rules, points=sets[active]):
            row = (step.pseudo, step.after.mean, step.after.largest)
            checkpoint = Checkpoint(
                step.basis,
                _replace_at(checkpoint.marks, active, step.mark),
                _replace_at(checkpoint.curves, active, _append_point(checkpoint.curves[active], row)),
            )
            if should_stop():
                return checkpoint
            if checkpoint.stopped or _next_set(checkpoint) != active:
                break
    return checkpoint


def _next_set(checkpoint: Checkpoint) -> int:
    """Index of the set of the next step: the unfinished set with the fewest steps."""
    unfinished = [k for k, mark in enumerate(checkpoint.marks) if not mark.stopped]
    return min(unfinished, key=lambda k: checkpoint.marks[k].number)


def _replace_at(values: tuple[Any, ...], index: int, value: Any) -> tuple[Any, ...]:
    return (*values[:index], value, *values[index + 1 :])


def _append_point(
    curve: tuple[tuple[int, float, float], ...], row: tuple[int, float, float]
) -> tuple[tuple[int, float, float], ...]:
    """A curve with one more point; if too long, without the point that is closest to its neighbours.

    Distances are ratios of numbers of pseudo-examples, so the curve stays dense where the error falls fast.
    """
    longer = (*curve, row)
    if len(longer) <= MAX_CURVE:
        return longer
    positions = np.log1p([point[0] for point in longer])
    crowded = 1 + int(np.argmin(positions[2:] - positions[:-2]))
    return longer[:crowded] + longer[crowded + 1 :]
