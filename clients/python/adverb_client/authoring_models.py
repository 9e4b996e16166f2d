"""Versions, refinements, drafts and changes of verbs, as frozen dataclasses, and how they are parsed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["ENDED", "Access", "Change", "Draft", "DraftSummary", "Refinement", "Version"]

Json = Mapping[str, Any]

ENDED = frozenset({"published", "not_better", "failed", "cancelled", "given_up"})
"""States of a refinement that has ended."""


@dataclass(frozen=True, slots=True)
class Version:
    """One version of a verb.

    Parameters
    ----------
    verb : str
    number : int
    current : bool
        Whether this version is served.
    sha256 : str
        Of its artifact.
    size_bytes : int
    author, reason : str
    created_at_s : float
        Seconds since 1970.
    parent : int or None
        The version that it was refined from.
    source : bool
        Whether its source is stored, to which an example can be added.
    quality : mapping
        Figures that were measured when it was built.
    warnings : tuple of str
        Of its build; only in the answer to the publication.
    example : mapping
        Name, keytimes, confidence and measured adverbs of an added example; else empty.
    """

    verb: str
    number: int
    current: bool
    sha256: str
    size_bytes: int
    author: str
    reason: str
    created_at_s: float
    parent: int | None
    source: bool
    quality: Json
    warnings: tuple[str, ...]
    example: Json

    @classmethod
    def of_json(cls, fields: Json) -> Version:
        """Parse one version."""
        return cls(
            *(fields["verb"], fields["version"], fields["current"], fields["sha256"], fields["bytes"]),
            *(fields["author"], fields["reason"], fields["created_at"], fields["parent"], fields["source"]),
            *(fields["quality"], tuple(fields.get("warnings", ())), fields.get("example", {})),
        )


@dataclass(frozen=True, slots=True)
class Refinement:
    """One refinement of a verb.

    Parameters
    ----------
    id, verb : str
    state : str
        ``queued``, ``running``, or one of :data:`ENDED`.
    request, progress : mapping
        The request with its defaults; pseudo-examples, errors or costs so far, and figures at the end.
    version_before, version_after : int or None
    detail : str
        Why it ended.
    created_at_s, updated_at_s : float
        Seconds since 1970.
    """

    id: str
    verb: str
    state: str
    request: Json
    progress: Json
    version_before: int | None
    version_after: int | None
    detail: str
    created_at_s: float
    updated_at_s: float

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self.state in ENDED

    @classmethod
    def of_json(cls, fields: Json) -> Refinement:
        """Parse one refinement."""
        return cls(
            *(fields["id"], fields["verb"], fields["state"], fields["request"], fields["progress"]),
            *(fields["version_before"], fields["version_after"], fields["detail"]),
            *(fields["created_at"], fields["updated_at"]),
        )


@dataclass(frozen=True, slots=True)
class DraftSummary:
    """One draft of the list; ``built`` is whether its clips make a verb."""

    id: str
    revision: int
    name: str
    clips: int
    excluded: int
    built: bool
    size_bytes: int
    changed_at_s: float
    expires_at_s: float

    @classmethod
    def of_json(cls, fields: Json) -> DraftSummary:
        """Parse one row of the list."""
        return cls(
            *(fields["id"], fields["revision"], fields["name"], fields["clips"], fields["excluded"], fields["built"]),
            *(fields["bytes"], fields["changed_at"], fields["expires_at"]),
        )


@dataclass(frozen=True, slots=True)
class Draft:
    """A folder of clips on its way to a verb.

    Parameters
    ----------
    id, name : str
    revision : int
        Rises with each change.
    clips : tuple of mapping
        With keytimes, confidence, adverbs, mends and problems; see docs/rest.md.
    problem : mapping or None
        ``code`` and ``detail``: why the clips make no verb.
    toml : str
        The ``verb.toml``.
    fields : mapping
        The whole answer.
    """

    id: str
    revision: int
    name: str
    clips: tuple[Json, ...]
    problem: Json | None
    toml: str
    fields: Json

    @classmethod
    def of_json(cls, fields: Json) -> Draft:
        """Parse one draft."""
        return cls(
            *(fields["id"], fields["revision"], fields["name"], tuple(fields["clips"])),
            *(fields["problem"], fields["toml"], fields),
        )


@dataclass(frozen=True, slots=True)
class Change:
    """One change of a verb in the list of changes.

    Parameters
    ----------
    id : int
        Rises with each change.
    verb : str
    kind : str
        ``publish``, ``activate``, ``delete``, ``refine`` or ``cancel``.
    number : int
        Version that was published, activated, refined, or current before the deletion.
    current : int or None
        Current version after the change.
    author, reason : str
    at_s : float
        Seconds since 1970.
    """

    id: int
    verb: str
    kind: str
    number: int
    current: int | None
    author: str
    reason: str
    at_s: float

    @classmethod
    def of_json(cls, fields: Json) -> Change:
        """Parse one change."""
        return cls(
            *(fields["id"], fields["verb"], fields["kind"], fields["number"], fields["current"]),
            *(fields["author"], fields["reason"], fields["at"]),
        )


@dataclass(frozen=True, slots=True)
class Access:
    """The key of this client: whether the server requires one, its id, name and scopes, and when it expires."""

    required: bool
    id: str
    name: str
    scopes: tuple[str, ...]
    expires_at_s: float | None

    @classmethod
    def of_json(cls, fields: Json) -> Access:
        """Parse the answer."""
        return cls(fields["required"], fields["id"], fields["name"], tuple(fields["scopes"]), fields["expires_at"])
