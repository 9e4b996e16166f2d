"""Parameters of a refinement job."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from verbs.errors import OutOfRange, UnknownName
from verbs.refine import Rules

__all__ = ["METHODS", "RefinementSpec"]

METHODS = ("refined", "hybrid")
"""Methods that use a refined basis; results are compared by one of them."""

MAX_BUDGET_S = 7 * 24 * 3600.0

PRIORITIES = (1, 100)
"""Highest and lowest priority."""


@dataclass(frozen=True, slots=True)
class RefinementSpec:
    """Parameters of a refinement job.

    Parameters
    ----------
    target_error : float
        Largest error on the search points at which to stop, as a share of the diagonal of the examples' goals
        (0.01 is one percent).
    max_pseudo : int
        Number of pseudo-examples at which to stop.
    budget_s : float
        Computing time after which to stop, seconds: the sum over finished steps on all workers.
    method : str
        Method by which the result is compared, one of :data:`METHODS`; the refined basis is the same for both.
    weighted_by_traffic : bool
        Whether every second pseudo-example is placed by the recorded usage of the verb, and half of the held-out points
        are sampled from it.
    seed : int
        Seed of search points and held-out points.
    priority : int
        1 (first) to 100 (last).
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
        assert self.rules is not None  # checks the other fields

    @property
    def rules(self) -> Rules:
        """Rules of the refinement; raises :class:`OutOfRange` if a number is out of range."""
        return Rules(target_error=self.target_error, max_pseudo=self.max_pseudo, seed=self.seed)

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> RefinementSpec:
        """Read JSON values; raises :class:`UnknownName` or :class:`OutOfRange`."""
        known = {field.name: type(field.default) for field in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise UnknownName("field", name, known)
            kinds = (int, float) if known[name] is float else (known[name],)
            if type(value) not in kinds:  # excludes bool from numbers
                raise OutOfRange(f"{name} is {value!r:.40}; it must be of the type {known[name].__name__}")
        return cls(**values)
