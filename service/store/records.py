"""What the store keeps, and everything that can go wrong with it, in one tree.

::

    StoreError
    ├── BadAddress         an address names no database or place for artifacts that Adverb knows
    ├── InvalidValue       a name, a text or a JSON value is not one that the store keeps
    ├── UnknownVerb        no such verb is served, or was ever published (verb, known)
    ├── UnknownVersion     the verb has no such version (verb, number, known)
    ├── UnknownJob         there is no such refinement job (id)
    ├── JobExists          a job has this id already (id)
    ├── JobEnded           the job has ended and does not go on (id, state)
    ├── Conflict           the verb points to another version than was expected (verb, expected, found)
    ├── ArtifactMissing    a version's blob is not where it should be, or is damaged (sha256)
    └── StoreUnavailable   the database or the artifacts cannot be reached now; asking again may help (reason)
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from verbs.verb import NAME

__all__ = [
    "ENDED",
    "STATES",
    "ArtifactMissing",
    "BadAddress",
    "Conflict",
    "Event",
    "InvalidValue",
    "Job",
    "JobEnded",
    "JobExists",
    "StoreError",
    "StoreUnavailable",
    "UnknownJob",
    "UnknownVerb",
    "UnknownVersion",
    "Version",
    "check_text",
    "check_verb",
    "json_text",
]

MAX_JSON_BYTES = 1024 * 1024
"""Longest JSON value that a row holds."""

MAX_LISTED = 16
"""Names or numbers that one error lists."""

STATES = frozenset({"queued", "running", "published", "not_better", "failed", "cancelled", "given_up"})
"""States of a refinement job."""

ENDED = STATES - {"queued", "running"}
"""States that a job does not leave."""


@dataclass(frozen=True, slots=True)
class Version:
    """One published version of a verb. It never changes.

    Parameters
    ----------
    verb : str
    number : int
        Counts from 1 for each verb, without gaps when it is given; collected numbers are not given again.
    sha256 : str
        Of the artifact's bytes, 64 hexadecimal digits; it names the blob.
    size_bytes : int
    author, reason : str
        Who published it, and why.
    quality : mapping
        JSON values: measured figures.
    created_at_s : float
        Seconds since 1970, UTC.
    parent : int or None
        The version that it was refined from.
    """

    verb: str
    number: int
    sha256: str
    size_bytes: int
    author: str
    reason: str
    quality: Mapping[str, Any]
    created_at_s: float
    parent: int | None


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that was done to a verb.

    Parameters
    ----------
    verb : str
    kind : str
        ``"publish"``, ``"activate"`` or ``"delete"``.
    number : int
        The version that was published or activated, or was current before the verb was deleted.
    current : int or None
        The version that the verb points to since; None where it points to none.
    author, reason : str
        Who did it, and why.
    at_s : float
        Seconds since 1970, UTC.
    """

    verb: str
    kind: str
    number: int
    current: int | None
    author: str
    reason: str
    at_s: float


@dataclass(frozen=True, slots=True)
class Job:
    """A refinement as its user sees it.

    Parameters
    ----------
    id, verb : str
    state : str
        One of :data:`STATES`.
    request, progress : mapping
        JSON values: the parameters of the job with its author, and how far it is.
    reaps : int
        How often another worker took it over.
    version_before, version_after : int or None
        The version that is refined, and the one that was published.
    detail : str
        One sentence for its user.
    created_at_s, updated_at_s : float
        Seconds since 1970, UTC.
    """

    id: str
    verb: str
    state: str
    request: Mapping[str, Any]
    progress: Mapping[str, Any]
    reaps: int
    version_before: int | None
    version_after: int | None
    detail: str
    created_at_s: float
    updated_at_s: float


class StoreError(Exception):
    """Root of everything that goes wrong in the store."""


class BadAddress(StoreError):
    """An address names no database or place for artifacts that Adverb knows; the message says which it knows."""


class InvalidValue(StoreError):
    """A name, a text or a JSON value is not one that the store keeps; the message says what it keeps."""


class UnknownVerb(StoreError):
    """No such verb is served, or was ever published.

    Attributes
    ----------
    verb : str
    known : tuple of str
        Verbs that there are.
    """

    def __init__(self, verb: str, known: Iterable[str]) -> None:
        self.verb, self.known = verb, tuple(known)
        super().__init__(f"there is no verb '{verb}'; there are: {_listed(self.known)}")


class UnknownVersion(StoreError):
    """The verb has no such version, or it was collected.

    Attributes
    ----------
    verb : str
    number : int
    known : tuple of int
        Numbers that there are.
    """

    def __init__(self, verb: str, number: int, known: Iterable[int]) -> None:
        self.verb, self.number, self.known = verb, number, tuple(known)
        super().__init__(f"verb '{verb}' has no version {number}; there are: {_listed(self.known)}")


class UnknownJob(StoreError):
    """There is no refinement job with this ``id``."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"there is no refinement job '{id}'")


class JobExists(StoreError):
    """A refinement job has this ``id`` already."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"there is a refinement job '{id}' already")


class JobEnded(StoreError):
    """The job with this ``id`` has ended in ``state`` and does not go on."""

    def __init__(self, id: str, state: str) -> None:
        self.id, self.state = id, state
        super().__init__(f"refinement job '{id}' has ended ({state}); start another one")


class Conflict(StoreError):
    """Somebody else changed what the verb points to.

    Attributes
    ----------
    verb : str
    expected, found : int
        Numbers of the current version; 0 stands for none.
    """

    def __init__(self, verb: str, expected: int, found: int) -> None:
        self.verb, self.expected, self.found = verb, expected, found
        points = f"points to version {found}" if found else "points to no version"
        super().__init__(f"verb '{verb}' {points}, not to {expected or 'none'}: read it again")


class ArtifactMissing(StoreError):
    """The blob named ``sha256`` is not where it should be, or is damaged."""

    def __init__(self, sha256: str, problem: str) -> None:
        self.sha256 = sha256
        super().__init__(f"artifact {sha256[:12]}… {problem}")


class StoreUnavailable(StoreError):
    """The database or the artifacts cannot be reached now; ``reason`` is short and names no secret."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the store is unavailable: {reason}")


def _listed(known: tuple[Any, ...]) -> str:
    more = ", …" if len(known) > MAX_LISTED else ""
    return (", ".join(str(name) for name in known[-MAX_LISTED:]) or "none") + more


def check_verb(name: str) -> str:
    """The name, where a verb may be called so; raises :class:`InvalidValue`."""
    if NAME.fullmatch(name) is None:
        raise InvalidValue(f"{name!r:.80} is no verb name ({NAME.pattern})")
    return name


def check_text(what: str, text: str, limit: int, *, empty: bool = True) -> str:
    """The text, where a row can hold it; raises :class:`InvalidValue`."""
    if len(text) > limit or not (text or empty):
        raise InvalidValue(f"'{what}' must have {0 if empty else 1} to {limit} characters; it has {len(text)}")
    if "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text):
        raise InvalidValue(f"'{what}' has a character that is no text")
    return text


def json_text(what: str, value: Mapping[str, Any]) -> str:
    """A mapping as JSON of bounded length; raises :class:`InvalidValue`."""
    try:
        text = json.dumps(dict(value), allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError, RecursionError) as err:
        raise InvalidValue(f"'{what}' is no JSON object: {err}") from err
    if len(text) > MAX_JSON_BYTES:
        raise InvalidValue(f"'{what}' may be {MAX_JSON_BYTES} bytes of JSON; it is {len(text)}")
    return text
