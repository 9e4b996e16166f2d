"""Estimates of the server's clock and of the lateness of its messages."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

__all__ = ["Clock", "Lateness"]


class Clock:
    """Offset between the server's clock and this machine's, estimated by pings.

    A ping with a round trip of r seconds gives the offset to within r / 2, whatever the shares of its two ways. The
    estimate is that of the ping with the shortest round trip in the window; there is no averaging.

    Parameters
    ----------
    window_s : float
        How long a ping counts, seconds: clocks drift apart by about 10 µs per second.
    """

    def __init__(self, window_s: float = 60.0) -> None:
        self._window_s = window_s
        self._pings: deque[tuple[float, float, float]] = deque(maxlen=256)  # arrival, round trip, offset

    def add(self, sent_s: float, arrived_s: float, server_time_ns: int) -> None:
        """Add a ping; one that arrives before it was sent is ignored.

        Parameters
        ----------
        sent_s, arrived_s : float
            Times on this machine's monotonic clock.
        server_time_ns : int
            Time on the server's clock when it answered.
        """
        if arrived_s < sent_s:
            return
        middle_s = 0.5 * (sent_s + arrived_s)
        self._pings.append((arrived_s, arrived_s - sent_s, server_time_ns * 1e-9 - middle_s))
        while self._pings[0][0] < arrived_s - self._window_s:
            self._pings.popleft()

    def clear(self) -> None:
        """Discard all samples; another server has another clock."""
        self._pings.clear()

    @property
    def known(self) -> bool:
        """Whether there is a ping in the window."""
        return bool(self._pings)

    @property
    def round_trip_s(self) -> float:
        """Shortest round trip, seconds; NaN before the first ping."""
        return min((ping[1] for ping in self._pings), default=math.nan)

    @property
    def offset_s(self) -> float:
        """Server's clock minus this machine's, seconds; NaN before the first ping."""
        return min(self._pings, key=lambda ping: ping[1])[2] if self._pings else math.nan

    def age_s(self, now_s: float, server_time_s: float) -> float:
        """Time since an instant on the server's clock, seconds; NaN before the first ping."""
        return now_s + self.offset_s - server_time_s


class Lateness:
    """Lateness of messages relative to the earliest ones.

    The transit of a message is its arrival on this machine's clock minus its due time on the server's. Lateness is a
    quantile of the transits minus the smallest one, so the offset between the clocks cancels.

    Parameters
    ----------
    window : int
        Number of most recent messages.
    quantile : float
        The quantile of transits that lateness covers.
    """

    def __init__(self, window: int = 512, quantile: float = 0.98) -> None:
        self._transits = np.zeros(window)
        self._quantile = quantile
        self._count = 0
        self._cached: tuple[float, float] | None = None

    def add(self, arrived_s: float, due_s: float) -> None:
        """Add a message: its arrival on this machine's clock and its due time on the server's, seconds."""
        self._transits[self._count % len(self._transits)] = arrived_s - due_s
        self._count += 1
        self._cached = None

    def clear(self) -> None:
        """Discard all samples; another server has another clock."""
        self._count, self._cached = 0, None

    def __len__(self) -> int:
        return min(self._count, len(self._transits))

    def measured(self) -> tuple[float, float] | None:
        """The smallest transit and the lateness, seconds; None before the first message."""
        found = self._cached  # another thread may add a message meanwhile
        if found is None and self._count:
            transits = np.sort(self._transits[: len(self)])
            late = transits[min(len(transits) - 1, math.ceil(self._quantile * len(transits)))]
            self._cached = found = float(transits[0]), float(late - transits[0])
        return found
