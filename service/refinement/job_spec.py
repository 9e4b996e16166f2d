"""What a refinement job is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from verbs.errors import OutOfRange, UnknownName
from verbs.refine import Rules

__all__ = ["METHODS", "Asked"]

METHODS = ("refined", "hybrid")
"""Methods that a refined basis serves, and by which a job can be judged."""

MAX_BUDGET_S = 7 * 24 * 3600.0

PRIORITIES = (1, 100)
"""The most and the least urgent."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a refinement job is asked for.

    Parameters
    ----------
    target_error : float
        Largest error on the search points at which to stop, as a share of the diagonal of the examples' goals
        (0.01 is one percent).
    max_pseudo : int
        Number of pseudo-examples at which to stop.
    budget_s : float
        Computing time after which to stop, seconds: that of finished steps, on all workers together.
    method : str
        Method by which the result is judged, of :data:`METHODS`; the refined basis is the same for both.
    weighted_by_traffic : bool
        Whether every second pseudo-example goes to the worst of the places where the verb has been asked for, and the
        result is judged on such places too.
    seed : int
        What search points and held-out points are drawn from.
    priority : int
        1 is served first, 100 last.
    """

    target_error: float = 0.01
    max_pseudo: int = 300
    budget_s: float = 600.0
    method: str = "refined"
    weighted_by_traffic: bool = False
    seed: int = 1
    priority: int = 50

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise UnknownName("method", self.method, METHODS)
        if not 0.0 < self.budget_s <= MAX_BUDGET_S:  # NaN compares false
            raise OutOfRange(f"budget_s is {self.budget_s}; it must be positive and at most {MAX_BUDGET_S:.0f}")
        if not PRIORITIES[0] <= self.priority <= PRIORITIES[1]:
            raise OutOfRange(f"priority is {self.priority}; it must lie between {PRIORITIES[0]} and {PRIORITIES[1]}")
        assert self.rules is not None  # which checks the rest

    @property
    def rules(self) -> Rules:
        """Rules of the refinement; raises :class:`OutOfRange` where a number is out of its bounds."""
        return Rules(target_error=self.target_error, max_pseudo=self.max_pseudo, seed=self.seed)

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Asked:
        """From JSON values; raises :class:`UnknownName` for a name that there is not."""
        known = {field.name: type(field.default) for field in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise UnknownName("field", name, known)
            kinds = (int, float) if known[name] is float else (known[name],)
            if type(value) not in kinds:  # true is no number
                raise OutOfRange(f"{name} is {value!r:.40}; it must be of the type {known[name].__name__}")
        return cls(**values)
