"""The table of blending methods: a new one is one file and one row here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from verbs.blend.cardinal import Rbf
from verbs.blend.corrected import Corrected
from verbs.blend.search import Search
from verbs.conventions import F64
from verbs.errors import UnknownName
from verbs.verb import Verb

__all__ = ["METHODS", "Method", "default_method", "make"]


class Method(Protocol):
    """Adverbs in, weights out; ready to be asked from several threads at once."""

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N), each row summing to 1, at adverbs (B, D) inside the domain."""
        ...


METHODS: dict[str, Callable[[Verb], Method]] = {
    "rbf": Rbf.of_verb,
    "search": Search.of_verb,
    "corrected": Corrected.of_verb,
}
"""Every method by name, as a function that prepares it for a verb."""


def default_method(verb: Verb) -> str:
    """Name of the method that a verb uses when none is asked for: ``corrected`` for every measured verb."""
    return "corrected" if "smooth" in verb.bases else "rbf"


def make(name: str, verb: Verb) -> Method:
    """Prepare a method for a verb; raises :class:`UnknownName` with the names that exist."""
    if name not in METHODS:
        raise UnknownName("method", name, METHODS)
    return METHODS[name](verb)
