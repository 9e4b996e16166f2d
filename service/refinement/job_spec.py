"""Parameters of a refinement job."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from verbs import refine, refine_quality
from verbs.errors import OutOfRange, UnknownName

__all__ = ["AIMS", "METHODS", "RefinementSpec"]

AIMS = ("error", "quality")
"""What a refinement is for: smaller errors of ``refined`` and ``hybrid``, or better motion of ``corrected``."""

METHODS = ("refined", "hybrid")
"""Methods that use a refined basis; results are compared by one of them."""

MAX_BUDGET_S = 7 * 24 * 3600.0

MAX_PSEUDO = {"error": 300, "quality": 8}
"""Default number of pseudo-examples, by aim."""

ERROR_ONLY = ("target_error", "method", "weighted_by_traffic")
"""Parameters without a meaning in a refinement for quality."""

PRIORITIES = (1, 100)
"""Highest and lowest priority."""


@dataclass(frozen=True, slots=True)
class RefinementSpec:
    """Parameters of a refinement job.

    Parameters
    ----------
    aim : str
        One of :data:`AIMS`; ``for`` in JSON.
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

    aim: str = "error"
    target_error: float = 0.01
    max_pseudo: int = 300
    budget_s: float = 600.0
    method: str = "refined"
    weighted_by_traffic: bool = False
    seed: int = 1
    priority: int = 50

    def __post_init__(self) -> None:
        if self.aim not in AIMS:
            raise UnknownName("for", self.aim, AIMS)
        if self.method not in METHODS:
            raise UnknownName("method", self.method, METHODS)
        if not 0.0 < self.budget_s <= MAX_BUDGET_S:  # NaN compares false
            raise OutOfRange(f"budget_s is {self.budget_s}; it must be positive and at most {MAX_BUDGET_S:.0f}")
        if not PRIORITIES[0] <= self.priority <= PRIORITIES[1]:
            raise OutOfRange(f"priority is {self.priority}; it must lie between {PRIORITIES[0]} and {PRIORITIES[1]}")
        rules = self.rules if self.aim == "error" else self.quality_rules
        assert rules is not None  # checks the other fields

    @property
    def rules(self) -> refine.Rules:
        """Rules of a refinement for error; raises :class:`OutOfRange` if a number is out of range."""
        return refine.Rules(target_error=self.target_error, max_pseudo=self.max_pseudo, seed=self.seed)

    @property
    def quality_rules(self) -> refine_quality.Rules:
        """Rules of a refinement for quality; raises :class:`OutOfRange` if a number is out of range."""
        return refine_quality.Rules(max_pseudo=self.max_pseudo, seed=self.seed)

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        values = asdict(self)
        return {"for": values.pop("aim")} | values

    @classmethod
    def of_request(cls, given: Mapping[str, Any], *, exact: bool) -> RefinementSpec:
        """Parameters from those that a client gives; the others have the defaults of the aim.

        Parameters
        ----------
        given : mapping
            Without an aim it is quality for exact verbs, unless a parameter of refinements for error is given.
        exact : bool
            Whether the verb's default method is ``corrected``.

        Raises
        ------
        UnknownName, OutOfRange
            A parameter is unknown, out of range, or has no meaning for the aim.
        """
        others = [name for name in ERROR_ONLY if name in given]
        aim = given.get("for", "quality" if exact and not others else "error")
        if aim == "quality" and others:
            raise OutOfRange(f"{others[0]} has no meaning in a refinement for quality; leave it out")
        return cls.from_json({"max_pseudo": MAX_PSEUDO.get(aim, 0), **given, "for": aim})

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> RefinementSpec:
        """Read JSON values; raises :class:`UnknownName` or :class:`OutOfRange`. Without an aim it is error."""
        known = {"for" if field.name == "aim" else field.name: type(field.default) for field in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise UnknownName("field", name, known)
            kinds = (int, float) if known[name] is float else (known[name],)
            if type(value) not in kinds:  # excludes bool from numbers
                raise OutOfRange(f"{name} is {value!r:.40}; it must be of the type {known[name].__name__}")
        return cls(**{"aim" if name == "for" else name: value for name, value in values.items()})
