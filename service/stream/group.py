"""A group: one version of a verb with the characters that are blended by one method."""

from __future__ import annotations

from service.catalog.catalog import Entry
from verbs.runtime.characters import Characters

__all__ = ["Group"]


class Group:
    """The characters of one version of a verb, blended by one method.

    Parameters
    ----------
    entry : Entry
    method : str
    """

    def __init__(self, entry: Entry, method: str) -> None:
        self.entry = entry
        self.characters = Characters(entry.evaluator, method)

    @property
    def key(self) -> tuple[str, int, str]:
        """Verb, version and method."""
        return self.entry.verb.name, self.entry.version, self.characters.method
