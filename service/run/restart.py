"""Restarts: their pauses, and the names of refiners that stay the same over them."""

from __future__ import annotations

import os
import platform
import re
import time

__all__ = ["FIRST_PAUSE_S", "LONGEST_PAUSE_S", "STABLE_S", "Pauses", "name_of"]

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
"""Shortest and longest pause before a child that died is started again, seconds."""

STABLE_S = 60.0
"""After a child has run for so long, its death is a new failure: the pauses start again from the shortest."""


class Pauses:
    """Pauses before restarts, each twice as long as the one before while the child keeps dying early."""

    def __init__(self) -> None:
        self._pause_s, self._started_s = FIRST_PAUSE_S, 0.0

    def started(self) -> None:
        """Record that the child starts."""
        self._started_s = time.monotonic()

    def next_s(self) -> float:
        """Pause before the restart of a child that just died, seconds."""
        if time.monotonic() - self._started_s > STABLE_S:
            self._pause_s = FIRST_PAUSE_S
        pause_s, self._pause_s = self._pause_s, min(2 * self._pause_s, LONGEST_PAUSE_S)
        return pause_s


def name_of(number: int) -> str:
    """Executor name of a refiner of this process; no other process of any machine has a refiner of that name."""
    node = re.sub(r"[^A-Za-z0-9-]+", "-", platform.node()).strip("-")[:40]
    return f"{node or 'server'}.{os.getpid()}.{number}"
