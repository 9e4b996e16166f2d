"""Interest: which records of a message are sent where a client has set a byte budget.

A channel's priority accumulates in every tick in which it is not sent, and starts over when it is. The records with the
most are sent, as far as the budget goes, and nothing is skipped for a smaller record after it: so every channel is sent
in its turn, however low its priority.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from service.stream.kernels import choose
from verbs.conventions import F64, I64

__all__ = ["NEAR_M", "Interest"]

NEAR_M = 10.0
"""Distance from the viewpoint at which the priority of a channel is half of its own, metres."""

SAVED_S = 0.25
"""What of a budget is not used can be used so much later, seconds."""

STATS_S = 1.0


class Interest:
    """Budget, viewpoint and accumulated priorities of one session.

    Parameters
    ----------
    budget_kbps : float
        1 kbps is 1,000 bits per second.
    viewpoint : (3,) float64 or None
    """

    def __init__(self, budget_kbps: float, viewpoint: F64 | None) -> None:
        self.budget_kbps, self.viewpoint = budget_kbps, viewpoint
        self._numbers = np.empty(0, np.int64)
        self._waiting = np.empty(0)
        self._sent = np.empty(0, np.int64)
        self._left_out = self._bytes = 0
        self._saved = 0.0
        self._since_s = time.monotonic()

    def follow(self, other: Interest | None) -> None:
        """Keep what another one has accumulated."""
        if other is not None:
            self._numbers, self._waiting, self._sent = other._numbers, other._waiting, other._sent
            self._left_out, self._bytes, self._since_s = other._left_out, other._bytes, other._since_s
            self._saved = other._saved

    def choose(self, numbers: I64, priorities: F64, sizes: I64, positions: F64, *, fixed: int, step_s: float) -> I64:
        """Choose the records of a message that are sent: 1 or 0 for each (R,).

        Parameters
        ----------
        numbers : (R,) int64
            Channels, rising.
        priorities : (R,) float64
        sizes : (R,) int64
            Bytes of each record.
        positions : (R, 3) float64
            Position of each character.
        fixed : int
            Bytes of a message without records.
        step_s : float
            Time since the last message, seconds.
        """
        self._known(numbers)
        rows = np.searchsorted(self._numbers, numbers)
        rates = priorities
        if self.viewpoint is not None:
            rates = rates / (1.0 + np.linalg.norm(positions - self.viewpoint, axis=1) / NEAR_M)
        per_s = 125.0 * self.budget_kbps
        most = max(SAVED_S * per_s, float(fixed + sizes.max(initial=0)))
        self._saved = min(self._saved + step_s * per_s, most)
        chosen = np.zeros(len(numbers), np.int64)
        used = choose(rates * step_s, sizes, rows, fixed, self._saved, self._waiting, chosen)
        self._saved -= used
        self._bytes += used
        self._sent[rows] += chosen
        self._left_out += len(numbers) - int(chosen.sum())
        return chosen

    def stats(self, now_s: float) -> dict[str, Any] | None:
        """The message ``stats``, once in a second."""
        seconds = now_s - self._since_s
        if seconds < STATS_S:
            return None
        sent = self._sent
        message = {
            "op": "stats",
            "seconds": round(seconds, 3),
            "kbps": round(self._bytes / 125.0 / seconds, 1),
            "budget_kbps": self.budget_kbps,
            "records": int(sent.sum()),
            "left_out": self._left_out,
            "min_fps": round(float(sent.min(initial=0 if not len(sent) else sent[0])) / seconds, 2),
            "max_fps": round(float(sent.max(initial=0)) / seconds, 2),
        }
        self._sent = np.zeros_like(sent)
        self._left_out = self._bytes = 0
        self._since_s = now_s
        return message

    def keep(self, numbers: Sequence[int]) -> None:
        """Keep what belongs to these channels, rising, and forget the others."""
        kept = np.array(numbers, np.int64)
        waiting, sent = np.zeros(len(kept)), np.zeros(len(kept), np.int64)
        if len(self._numbers):
            at = np.minimum(np.searchsorted(self._numbers, kept), len(self._numbers) - 1)
            same = self._numbers[at] == kept
            waiting[same], sent[same] = self._waiting[at[same]], self._sent[at[same]]
        self._numbers, self._waiting, self._sent = kept, waiting, sent

    def _known(self, numbers: I64) -> None:
        """Make room for channels that are new."""
        at = np.searchsorted(self._numbers, numbers)
        if len(self._numbers) == 0 or np.any(self._numbers[np.minimum(at, len(self._numbers) - 1)] != numbers):
            self.keep(np.union1d(self._numbers, numbers).tolist())
