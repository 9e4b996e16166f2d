"""Result of a load of crowds."""

from __future__ import annotations

from dataclasses import dataclass

from adverb_load.client import Load
from adverb_load.tally import Lateness

__all__ = ["CrowdReport"]


@dataclass(frozen=True, slots=True)
class CrowdReport:
    """What arrived within the window.

    Parameters
    ----------
    load : Load
    seconds : float
    delivered, expected : int
        Records, which are poses.
    messages, bytes : int
    gaps, dropped, wrong : int
        Messages that are missing unreported, that the server reports as not sent, and that are malformed.
    lateness_ms : Lateness
        Arrival minus due time of messages.
    clock_ms : float
        Uncertainty of lateness: half the shortest round trip of the worst socket.
    server_cpu_s, reader_cpu : float
        CPU seconds of the server; share of a core that this process used.
    clamped : int
        Records whose goal was outside the domain.
    stated_m, measured_m : float
        Largest error in records' headers; largest distance between effector and goal in the sample.
    samples, events, steered, held_back : int
        Measured records; texts with keytimes; goals that were sent, and held back because the server did not read.
    codes : dict
        Errors and closed connections.
    """

    load: Load
    seconds: float
    delivered: int
    expected: int
    messages: int
    bytes: int
    gaps: int
    dropped: int
    wrong: int
    lateness_ms: Lateness
    clock_ms: float
    server_cpu_s: float
    reader_cpu: float
    clamped: int
    stated_m: float
    measured_m: float
    samples: int
    events: int
    steered: int
    held_back: int
    codes: dict[str, int]

    @property
    def share(self) -> float:
        """Delivered of expected poses."""
        return self.delivered / self.expected

    @property
    def us_per_pose(self) -> float:
        """Server CPU per delivered pose, µs; infinite without poses."""
        return 1e6 * self.server_cpu_s / self.delivered if self.delivered else float("inf")
