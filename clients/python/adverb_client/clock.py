"""Two clocks: how far the server's is from ours, and how late what it sends comes."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

__all__ = ["Clock", "Lateness"]


class Clock:
    """The server's clock as seen from here, by pings.

    A ping that takes r seconds tells the offset to within r / 2, whichever way the time was lost. So the quickest of
    the last pings is believed, and the others are not averaged in.

    Parameters
    ----------
    window_s : float
        How long a ping is believed, seconds: two clocks drift apart by some 10 µs a second.
    """

    def __init__(self, window_s: float = 60.0) -> None:
        self._window_s = window_s
        self._pings: deque[tuple[float, float, float]] = deque(maxlen=256)  # when, round trip, offset

    def add(self, sent_s: float, arrived_s: float, server_time_ns: int) -> None:
        """Count a ping.

        Parameters
        ----------
        sent_s, arrived_s : float
            On this machine's monotonic clock.
        server_time_ns : int
            On the server's, between the two.
        """
        if arrived_s < sent_s:
            return
        middle_s = 0.5 * (sent_s + arrived_s)
        self._pings.append((arrived_s, arrived_s - sent_s, server_time_ns * 1e-9 - middle_s))
        while self._pings[0][0] < arrived_s - self._window_s:
            self._pings.popleft()

    def clear(self) -> None:
        """Forget all: another server has another clock."""
        self._pings.clear()

    @property
    def known(self) -> bool:
        """Whether there was a ping yet."""
        return bool(self._pings)

    @property
    def round_trip_s(self) -> float:
        """Of the quickest ping; NaN before the first."""
        return min((ping[1] for ping in self._pings), default=math.nan)

    @property
    def offset_s(self) -> float:
        """What to add to a time of this machine to have the server's; NaN before the first ping."""
        return min(self._pings, key=lambda ping: ping[1])[2] if self._pings else math.nan

    def age_s(self, now_s: float, server_time_s: float) -> float:
        """How long ago something was on the server's clock; NaN before the first ping."""
        return now_s + self.offset_s - server_time_s


class Lateness:
    """How late messages come, measured against the earliest of them.

    The transit of a message is when it came minus when it was due, on two clocks whose difference nobody needs to
    know: the least transit of the last messages is the ground, and lateness is what others take longer.

    Parameters
    ----------
    window : int
        Messages to look back on.
    quantile : float
        Share of the messages that the lateness covers.
    """

    def __init__(self, window: int = 512, quantile: float = 0.98) -> None:
        self._transits = np.zeros(window)
        self._quantile = quantile
        self._count = 0
        self._told: tuple[float, float] | None = None

    def add(self, arrived_s: float, due_s: float) -> None:
        """Count a message: when it arrived on this machine's clock, and when it was due on the server's."""
        self._transits[self._count % len(self._transits)] = arrived_s - due_s
        self._count += 1
        self._told = None

    def clear(self) -> None:
        """Forget all: another server has another clock."""
        self._count, self._told = 0, None

    def __len__(self) -> int:
        return min(self._count, len(self._transits))

    def measured(self) -> tuple[float, float] | None:
        """The least transit and the lateness, seconds; None before the first message."""
        told = self._told  # another thread may add while this one asks
        if told is None and self._count:
            transits = np.sort(self._transits[: len(self)])
            late = transits[min(len(transits) - 1, math.ceil(self._quantile * len(transits)))]
            self._told = told = float(transits[0]), float(late - transits[0])
        return told
