"""Errors of tasks on drafts; they leave the sandbox as data."""

from __future__ import annotations

from verbs.errors import VerbError

__all__ = ["InvalidDraft", "NotBuilt"]


class InvalidDraft(VerbError):
    """Values that cannot be stored in a draft.

    Attributes
    ----------
    errors : list of dict
        ``at`` and ``problem`` of each.
    """

    def __init__(self, errors: list[dict[str, str]]) -> None:
        self.errors = errors
        super().__init__(f"{errors[0]['at']}: {errors[0]['problem']}")


class NotBuilt(VerbError):
    """The clips of a draft make no verb."""
