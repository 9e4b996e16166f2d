"""Messages about a start that takes long."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from types import FrameType

__all__ = ["PAUSES_S", "Progress"]

PAUSES_S = (10.0, 20.0, 30.0)
"""Pauses between messages about a long start, seconds; the last one is repeated."""


class Progress:
    """Reports the duration of a start, at growing intervals, until it is closed.

    It uses the alarm signal, in the main thread: a process that forks has no threads.

    Parameters
    ----------
    report : callable
        Receives each line.
    pauses_s : sequence of float
    """

    def __init__(self, report: Callable[[str], None], pauses_s: Sequence[float] = PAUSES_S) -> None:
        self._line, self._pauses_s, self._started_s = report, list(pauses_s), time.monotonic()
        self._why = "; kernels are compiled at the first start, which takes a minute or two"
        signal.signal(signal.SIGALRM, self._report)
        self._wait()

    def close(self) -> None:
        """Report nothing more."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)

    def _wait(self) -> None:
        pause_s = self._pauses_s.pop(0) if len(self._pauses_s) > 1 else self._pauses_s[0]
        signal.setitimer(signal.ITIMER_REAL, pause_s)

    def _report(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._line(f"starting, {time.monotonic() - self._started_s:.0f} s so far{self._why}")
        self._why = ""
        self._wait()
