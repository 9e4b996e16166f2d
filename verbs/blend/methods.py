"""The table of blending methods: a new one is one file and one row here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from verbs.blend.barycentric import Barycentric
from verbs.blend.cardinal import Rbf
from verbs.blend.corrected import Corrected
from verbs.blend.inverse import Inverse
from verbs.blend.knn import Knn
from verbs.blend.perdof import PerDof
from verbs.blend.refined import Hybrid, Refined
from verbs.blend.search import Search
from verbs.conventions import F64
from verbs.errors import RequestError, UnknownName
from verbs.kernels import measure as measures
from verbs.verb import Verb

__all__ = ["METHODS", "Method", "default_method", "make", "usable"]


class Method(Protocol):
    """Adverbs in, weights out; safe for calls from several threads at once."""

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N), each row summing to 1, at adverbs (B, D) inside the domain."""
        ...


@dataclass(frozen=True, slots=True)
class Row:
    """How to prepare a method, the basis that it needs, and whether it needs something to measure.

    ``points``: whether it needs one point that all measured adverbs describe together.
    """

    make: Callable[[Verb], Method]
    basis: str = "rbf"
    measured: bool = False
    points: bool = False


METHODS: dict[str, Row] = {
    "rbf": Row(Rbf.of_verb),
    "perdof": Row(PerDof.of_verb),
    "search": Row(Search.of_verb, measured=True),
    "refined": Row(Refined.of_verb),
    "hybrid": Row(Hybrid.of_verb, measured=True),
    "barycentric": Row(Barycentric.of_verb),
    "knn": Row(Knn.of_verb),
    "inverse": Row(Inverse.of_verb, points=True),
    "corrected": Row(Corrected.of_verb, basis="smooth", measured=True),
}
"""Every method by name."""


def default_method(verb: Verb) -> str:
    """Name of the method that a verb uses by default: ``corrected`` for every measured verb."""
    return "corrected" if "corrected" in usable(verb) else "rbf"


def usable(verb: Verb) -> tuple[str, ...]:
    """Names of the methods that a verb can use."""
    return tuple(name for name, row in METHODS.items() if _missing(row, verb) is None)


def _missing(row: Row, verb: Verb) -> str | None:
    """What a verb lacks for a method, or None."""
    if row.basis not in verb.bases:
        return f"a basis '{row.basis}', which verb '{verb.name}' does not have: build it again with this version"
    if row.measured and verb.measure.kind == measures.NOTHING:
        return f"something to measure, and verb '{verb.name}' has style adverbs only"
    if row.points and verb.measure.kind == measures.ADVERBS:
        return f"one point that all adverbs describe, and those of verb '{verb.name}' name measures of their own"
    return None


def make(name: str, verb: Verb) -> Method:
    """Prepare a method for a verb.

    Raises
    ------
    UnknownName
        There is no such method; the message lists those that exist.
    RequestError
        The verb lacks what the method needs.
    """
    if name not in METHODS:
        raise UnknownName("method", name, METHODS)
    missing = _missing(METHODS[name], verb)
    if missing:
        raise RequestError(f"method '{name}' needs {missing}")
    return METHODS[name].make(verb)
