"""Samples of the goals of streamed characters, recorded as usage."""

from __future__ import annotations

from collections.abc import Iterable

from service.catalog.catalog import Entry
from service.refinement.usage import Usage
from service.stream.group import Group
from verbs.conventions import F64

__all__ = ["MAX_SAMPLES", "CharacterSampler", "Sample"]

MAX_SAMPLES = 256
"""Characters of a group that one sample holds; successive samples of a larger group take different ones."""

Sample = tuple[Entry, F64, F64]
"""A version of a verb, goals (S, D) and errors (S,) of its characters."""


class CharacterSampler:
    """Records goals and errors of characters.

    Parameters
    ----------
    usage : Usage
    """

    def __init__(self, usage: Usage) -> None:
        self._usage, self._round = usage, 0

    def take(self, groups: Iterable[Group]) -> list[Sample]:
        """Goals of the characters of some groups, and how far their poses are from them; in the engine's thread."""
        self._round += 1
        samples = []
        for group in groups:
            slots = group.characters.taken()
            if len(slots):
                step = -(-len(slots) // MAX_SAMPLES)
                slots = slots[self._round % step :: step]
                characters = group.characters
                samples.append((group.entry, characters.goals[slots], characters.errors(slots)))
        return samples

    def record(self, samples: list[Sample]) -> None:
        """Record samples; in the event loop."""
        for entry, goals, errors in samples:
            self._usage.record(entry, goals, errors, rows=len(goals))
