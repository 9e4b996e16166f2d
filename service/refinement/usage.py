"""What is asked of each verb: where, and how far the answers were from it; counted here, told to the store.

Answering only notes what was asked, a fifth of a microsecond; every few seconds a thread counts what was noted.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.catalog.catalog import Entry
from service.refinement.usage_counts import HALF_LIFE_S, counted, told
from verbs.conventions import F64
from verbs.goal import diagonal
from verbs.verb import Verb

__all__ = ["ERRORS_HALF_LIFE_S", "MAX_NOTED", "Adverbs", "Demand", "Noted", "Observed"]

MAX_NOTED = 16_384
"""Adverbs that are noted between two counts, and one more batch; the rest of a rush is not counted."""

ERRORS_HALF_LIFE_S = 600.0

FORGET_S = 7 * HALF_LIFE_S
"""Time after which a verb that nobody asks for is forgotten."""

Adverbs = Mapping[str, float] | Sequence[Mapping[str, float]] | F64
Noted = tuple[Entry, Adverbs, F64 | None]


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """What is known of one verb.

    Parameters
    ----------
    verb : Verb
    version : int
        The version that gave the newest answers.
    cells : tuple of arrays
        Indices and weights, see :func:`service.refinement.usage_counts.counted`.
    at_s : float
        When they were counted.
    errors : float
        Sum of the answers' errors, as shares of the diagonal of the examples' goals.
    answers : float
        Number of the answers that had an error. Both fade, and are of that version alone.
    """

    verb: Verb
    version: int
    cells: tuple[F64, F64]
    at_s: float
    errors: float = 0.0
    answers: float = 0.0

    @property
    def error(self) -> float:
        """Mean error of the answers, as a share of the diagonal; 0 where there were none."""
        return self.errors / self.answers if self.answers else 0.0

    def told(self) -> dict[str, Any]:
        """The cells, as the store keeps them."""
        return {**told(self.verb, *self.cells), "at_s": self.at_s}


class Demand:
    """Counts what is asked. :meth:`ask` and :meth:`take` belong to the event loop, :meth:`count` to one thread.

    Parameters
    ----------
    most : int
        See :data:`MAX_NOTED`; 0 counts nothing.
    """

    def __init__(self, most: int = MAX_NOTED) -> None:
        self._most, self._rows = most, 0
        self._noted: list[Noted] = []
        self.observed: dict[str, Observed] = {}

    def ask(self, entry: Entry, adverbs: Adverbs, errors: F64 | None = None, *, rows: int = 1) -> None:
        """Note adverbs that were answered: (rows, D), or as a client named them; and the answers' errors, metres."""
        if self._rows < self._most:
            self._rows += rows
            self._noted.append((entry, adverbs, errors))

    def take(self) -> list[Noted]:
        """What was noted since the last time."""
        noted, self._noted, self._rows = self._noted, [], 0
        return noted

    def count(self, noted: Sequence[Noted], now_s: float) -> list[str]:
        """Count what was noted; returns the verbs whose cells are others now."""
        asked: dict[Entry, list[Noted]] = defaultdict(list)
        for one in noted:
            asked[one[0]].append(one)
        for entry, rows in asked.items():
            was = self.observed.get(entry.verb.name)
            self.observed[entry.verb.name] = _merged(entry, rows, was, now_s)
        self.observed = {name: one for name, one in self.observed.items() if now_s - one.at_s < FORGET_S}
        return sorted({entry.verb.name for entry in asked})


def _merged(entry: Entry, noted: Sequence[Noted], was: Observed | None, now_s: float) -> Observed:
    """What is known of a verb, with what was noted since."""
    verb, adverbs = entry.verb, _adverbs(entry, noted)
    if was is None or not np.array_equal(was.verb.values, verb.values):  # other examples have other cells
        was = Observed(verb, entry.version, counted(verb, adverbs[:0]), now_s)
    age_s = max(now_s - was.at_s, 0.0)
    cells = counted(verb, adverbs, was.cells, faded=0.5 ** (age_s / HALF_LIFE_S))
    given = [errors for _, _, errors in noted if errors is not None]
    version = entry.version if given else was.version
    kept = 0.5 ** (age_s / ERRORS_HALF_LIFE_S) if version == was.version else 0.0
    errors = np.concatenate([*given, np.zeros(0)])
    errors = errors[np.isfinite(errors)]
    share = float(errors.sum()) / diagonal(verb) if len(errors) else 0.0
    return Observed(verb, version, cells, now_s, kept * was.errors + share, kept * was.answers + len(errors))


def _adverbs(entry: Entry, noted: Sequence[Noted]) -> F64:
    """Adverbs (B, D) that were noted, drawn back to the domain."""
    named: list[Mapping[str, float]] = []
    arrays: list[F64] = []
    for _, adverbs, _ in noted:
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
