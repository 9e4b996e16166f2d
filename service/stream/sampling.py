"""Samples of the goals of streamed characters, recorded as usage."""

from __future__ import annotations

from collections.abc import Iterable

from service.refinement.usage import Usage
from service.stream.group import Group

__all__ = ["MAX_SAMPLES", "CharacterSampler"]

MAX_SAMPLES = 256
"""Characters of a group that one sample holds; successive samples of a larger group take different ones."""


class CharacterSampler:
    """Records goals and errors of characters.

    Parameters
    ----------
    usage : Usage
    """

    def __init__(self, usage: Usage) -> None:
        self._usage, self._round = usage, 0

    def sample(self, groups: Iterable[Group]) -> None:
        """Record the goals of the characters of some groups, and how far their poses are from them."""
        self._round += 1
        for group in groups:
            slots = group.characters.taken()
            if len(slots):
                step = -(-len(slots) // MAX_SAMPLES)
                slots = slots[self._round % step :: step]
                characters = group.characters
                self._usage.record(group.entry, characters.goals[slots], characters.errors(slots), rows=len(slots))
