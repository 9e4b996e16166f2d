"""How long to wait before trying again."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

__all__ = ["Backoff"]


@dataclass(slots=True)
class Backoff:
    """Waits that double from one failure to the next, up to a bound, and are not the same for everybody.

    Parameters
    ----------
    first_s, longest_s : float
        Bounds of a wait, seconds.
    rng : random.Random
        Half of each wait is drawn by lot, so that clients of a server that was away do not come back all at once.
    """

    first_s: float = 0.1
    longest_s: float = 5.0
    rng: random.Random = field(default_factory=random.Random)
    failures: int = 0

    def next_s(self, asked_s: float | None = None) -> float:
        """Count one more failure and say how long to wait, seconds.

        Parameters
        ----------
        asked_s : float or None
            How long the server asks to wait; kept to, as far as the bound allows.
        """
        full = min(self.longest_s, self.first_s * 2.0 ** min(self.failures, 30))
        self.failures += 1
        drawn = full * (0.5 + 0.5 * self.rng.random())
        return max(drawn, min(asked_s or 0.0, self.longest_s))

    def succeeded(self) -> None:
        """Start anew."""
        self.failures = 0
