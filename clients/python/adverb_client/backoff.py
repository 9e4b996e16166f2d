"""Delays between attempts: exponential backoff with jitter."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

__all__ = ["Backoff"]


@dataclass(slots=True)
class Backoff:
    """Exponential backoff with jitter: delays double from one failure to the next, up to a bound.

    Parameters
    ----------
    initial_s, max_s : float
        First and longest delay, seconds.
    rng : random.Random
        Half of each delay is random, so that clients do not reconnect to a restarted server at once.
    """

    initial_s: float = 0.1
    max_s: float = 5.0
    rng: random.Random = field(default_factory=random.Random)
    failures: int = 0

    def next_s(self, requested_s: float | None = None) -> float:
        """Count a failure and return the delay before the next attempt, seconds.

        Parameters
        ----------
        requested_s : float or None
            The delay that the server requests; honoured up to ``max_s``.
        """
        full = min(self.max_s, self.initial_s * 2.0 ** min(self.failures, 30))
        self.failures += 1
        drawn = full * (0.5 + 0.5 * self.rng.random())
        return max(drawn, min(requested_s or 0.0, self.max_s))

    def reset(self) -> None:
        """Start again at the first delay."""
        self.failures = 0
