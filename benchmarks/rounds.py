"""Rounds of one load: what each gave, and how long others kept the server off its core."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from math import nan
from typing import Generic, TypeVar

from adverb_load.client import Load
from adverb_load.process import Served

__all__ = ["Rounds"]

Report = TypeVar("Report")


@dataclass(slots=True)
class Rounds(ABC, Generic[Report]):
    """What rounds of one load gave.

    Parameters
    ----------
    name : str
    load : Load
    server : Served
    walk : bool
        Whether goals come from a walk through the verb's domain; the bare loop has no verb.
    reports : list
    waited : list of float
        Share of the time in which the server could have run, and others had its core: lateness is doubtful where it is
        not next to nothing.
    """

    name: str
    load: Load
    server: Served
    walk: bool = True
    reports: list[Report] = field(default_factory=list)
    waited: list[float] = field(default_factory=list)

    def play(self, seconds: float) -> None:
        """Run one round."""
        waited_s: list[float] = []

        def probe() -> float:
            waited_s.append(self.server.waited_s())
            return self.server.cpu_s()

        self.reports.append(self.run(seconds, probe))
        self.waited.append((waited_s[-1] - waited_s[0]) / seconds / len(self.server.servers))

    @abstractmethod
    def run(self, seconds: float, probe: Callable[[], float]) -> Report:
        """Play the load; ``probe`` gives the CPU time of the server, seconds."""

    def least(self, figure: Callable[[Report], float]) -> float:
        """The least of all rounds; NaN without one."""
        return min((figure(report) for report in self.reports), default=nan)
