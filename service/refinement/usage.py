"""Usage of each verb: which adverbs clients request, and the errors of the poses that they get.

Recording a request takes a fifth of a microsecond; a thread counts the recorded requests every few seconds.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.catalog.catalog import Entry
from service.refinement.usage_cells import HALF_LIFE_S, count_cells, to_json
from verbs.conventions import F64
from verbs.goal import diagonal
from verbs.verb import Verb

__all__ = ["ERRORS_HALF_LIFE_S", "MAX_RECORDED", "Adverbs", "Record", "Usage", "VerbUsage"]

MAX_RECORDED = 16_384
"""Poses recorded between two counts, and one more batch; further ones are not counted."""

ERRORS_HALF_LIFE_S = 600.0

FORGET_S = 7 * HALF_LIFE_S
"""Time after which a verb without requests is dropped, seconds."""

Adverbs = Mapping[str, float] | Sequence[Mapping[str, float]] | F64
Record = tuple[Entry, Adverbs, F64 | None]
"""Version that served a request, its adverbs, and the errors of its poses where they count."""


@dataclass(frozen=True, slots=True, eq=False)
class VerbUsage:
    """Usage of one verb.

    Parameters
    ----------
    verb : Verb
    version : int
        The version that gave the newest poses.
    cells : tuple of arrays
        Indices and weights, see :func:`service.refinement.usage_cells.count_cells`.
    at_s : float
        Time of the count, seconds since 1970, UTC.
    errors : float
        Sum of the poses' errors, as shares of the diagonal of the examples' goals.
    answers : float
        Number of poses with an error. Both decay, and count that version only.
    """

    verb: Verb
    version: int
    cells: tuple[F64, F64]
    at_s: float
    errors: float = 0.0
    answers: float = 0.0

    @property
    def error(self) -> float:
        """Mean error of the poses, as a share of the diagonal; 0 without any."""
        return self.errors / self.answers if self.answers else 0.0

    def to_json(self) -> dict[str, Any]:
        """The cells as JSON values, for the store."""
        return {**to_json(self.verb, *self.cells), "at_s": self.at_s}


class Usage:
    """Counts requested adverbs. The event loop calls :meth:`record` and :meth:`take`, one thread calls :meth:`count`.

    Parameters
    ----------
    limit : int
        See :data:`MAX_RECORDED`; 0 records nothing.
    """

    def __init__(self, limit: int = MAX_RECORDED) -> None:
        self._limit, self._rows = limit, 0
        self._records: list[Record] = []
        self.verbs: dict[str, VerbUsage] = {}

    def record(self, entry: Entry, adverbs: Adverbs, errors: F64 | None = None, *, rows: int = 1) -> None:
        """Record requested adverbs, (rows, D) or by name, and the errors of their poses, metres."""
        if self._rows < self._limit:
            self._rows += rows
            self._records.append((entry, adverbs, errors))

    def take(self) -> list[Record]:
        """Remove and return the records since the last call."""
        records, self._records, self._rows = self._records, [], 0
        return records

    def count(self, records: Sequence[Record], now_s: float) -> list[str]:
        """Add records to the counts; returns the verbs whose counts changed."""
        of_entry: dict[Entry, list[Record]] = defaultdict(list)
        for record in records:
            of_entry[record[0]].append(record)
        for entry, rows in of_entry.items():
            before = self.verbs.get(entry.verb.name)
            self.verbs[entry.verb.name] = _merged(entry, rows, before, now_s)
        self.verbs = {name: usage for name, usage in self.verbs.items() if now_s - usage.at_s < FORGET_S}
        return sorted({entry.verb.name for entry in of_entry})


def _merged(entry: Entry, records: Sequence[Record], before: VerbUsage | None, now_s: float) -> VerbUsage:
    """Usage of a verb with new records added."""
    verb, adverbs = entry.verb, _adverbs(entry, records)
    if before is None or not np.array_equal(before.verb.values, verb.values):  # other examples have other cells
        before = VerbUsage(verb, entry.version, count_cells(verb, adverbs[:0]), now_s)
    age_s = max(now_s - before.at_s, 0.0)
    cells = count_cells(verb, adverbs, before.cells, decay=0.5 ** (age_s / HALF_LIFE_S))
    measured = [errors for _, _, errors in records if errors is not None]
    version = entry.version if measured else before.version
    decay = 0.5 ** (age_s / ERRORS_HALF_LIFE_S) if version == before.version else 0.0
    errors = np.concatenate([*measured, np.zeros(0)])
    errors = errors[np.isfinite(errors)]
    share = float(errors.sum()) / diagonal(verb) if len(errors) else 0.0
    return VerbUsage(
        verb, version, cells, now_s, decay * before.errors + share, decay * before.answers + len(errors)
    )  # fmt: skip


def _adverbs(entry: Entry, records: Sequence[Record]) -> F64:
    """Recorded adverbs (B, D), clamped to the domain."""
    named: list[Mapping[str, float]] = []
    arrays: list[F64] = []
    for _, adverbs, _ in records:
        if isinstance(adverbs, np.ndarray):
            arrays.append(adverbs)
        elif isinstance(adverbs, Mapping):
            named.append(adverbs)
        else:
            named.extend(adverbs)
    if named:
        arrays.append(entry.evaluator.adverbs(named))
    inside, _ = entry.evaluator.clamp(np.ascontiguousarray(np.concatenate(arrays)))
    return inside
