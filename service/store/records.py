"""Records of the store, and the tree of its errors.

::

    StoreError
    ├── BadAddress         an address of the database or the artifacts is not supported
    ├── InvalidValue       a name, a text or a JSON value cannot be stored
    ├── UnknownVerb        the verb is not served, or was never published (verb, known)
    ├── UnknownVersion     the verb has no such version (verb, number, known)
    ├── UnknownJob         no refinement job has this id (id)
    ├── JobExists          a refinement job with this id exists (id)
    ├── JobEnded           the job has ended, and its state is final (id, state)
    ├── UnknownDraft       no draft has this id (id)
    ├── UnknownKey         no key has this id (id)
    ├── TooManyKeys        the limit of keys is reached (limit)
    ├── DraftChanged       the draft has another revision than expected (id, expected, found)
    ├── TooManyDrafts      the limit of drafts or of their bytes is reached (limit)
    ├── Conflict           another version is current than expected (verb, expected, found)
    ├── ArtifactMissing    the blob of a version is missing (sha256)
    │   └── ArtifactDamaged    its bytes do not match its hash
    └── StoreUnavailable   the database or the artifacts cannot be reached; retry later (reason)
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
    "ArtifactDamaged",
    "ArtifactMissing",
    "BadAddress",
    "Conflict",
    "Draft",
    "DraftChanged",
    "Event",
    "InvalidValue",
    "Job",
    "JobEnded",
    "JobExists",
    "Key",
    "StoreError",
    "StoreUnavailable",
    "TooManyDrafts",
    "TooManyKeys",
    "UnknownDraft",
    "UnknownJob",
    "UnknownKey",
    "UnknownVerb",
    "UnknownVersion",
    "Version",
    "check_text",
    "check_verb",
    "json_text",
]

MAX_JSON_BYTES = 1024 * 1024
"""Longest JSON value in a row, bytes."""

MAX_LISTED = 16
"""Largest number of names or numbers in an error message."""

STATES = frozenset({"queued", "running", "published", "not_better", "failed", "cancelled", "given_up"})
"""States of a refinement job."""

ENDED = STATES - {"queued", "running"}
"""Final states."""


@dataclass(frozen=True, slots=True)
class Version:
    """One published version of a verb; immutable.

    Parameters
    ----------
    verb : str
    number : int
        Counts from 1 for each verb; numbers of removed versions are not reused.
    sha256 : str
        Hash of the artifact, 64 hexadecimal digits; it names the blob.
    size_bytes : int
    author, reason : str
        Who published it, and why.
    quality : mapping
        Measured quality, JSON values.
    created_at_s : float
        Seconds since 1970, UTC.
    parent : int or None
        Version that it was refined from.
    source_sha256 : str or None
        Hash of the archive of its source, if that is stored.
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
    source_sha256: str | None = None


@dataclass(frozen=True, slots=True)
class Event:
    """One change of a verb.

    Parameters
    ----------
    verb : str
    kind : str
        ``"publish"``, ``"activate"``, ``"delete"``, ``"refine"`` or ``"cancel"``.
    number : int
        Version that was published or activated, that is refined, or that was current before the verb was deleted.
    current : int or None
        Current version after the change; None if the verb is not served.
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
class Key:
    """An API key; the key itself is not stored.

    Parameters
    ----------
    id : str
        16 hexadecimal digits; public.
    name : str
    scopes : frozenset of str
    sha256 : str
        Hash of the key, 64 hexadecimal digits.
    created_at_s : float
        Seconds since 1970, UTC.
    expires_at_s, revoked_at_s : float or None
    """

    id: str
    name: str
    scopes: frozenset[str]
    sha256: str
    created_at_s: float
    expires_at_s: float | None = None
    revoked_at_s: float | None = None

    def valid_at(self, now_s: float) -> bool:
        """Whether the key is neither revoked nor expired."""
        return self.revoked_at_s is None and (self.expires_at_s is None or now_s < self.expires_at_s)


@dataclass(frozen=True, slots=True)
class Job:
    """A refinement job.

    Parameters
    ----------
    id, verb : str
    state : str
        One of :data:`STATES`.
    request, progress : mapping
        JSON values: the parameters and author of the job, and its progress.
    reaps : int
        Number of times that another worker took it over.
    version_before, version_after : int or None
        Version that is refined, and the published result.
    detail : str
        One sentence about its outcome, for users.
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


@dataclass(frozen=True, slots=True)
class Draft:
    """A draft without its document.

    Parameters
    ----------
    id : str
    revision : int
        Counts from 1; every change increments it.
    name : str
        Name of the verb that it becomes.
    clips, excluded : int
        Number of clips in the verb, and of others.
    archive, motion : str
        Hashes of the blobs with the clips, and with the motions that are displayed.
    artifact : str or None
        Hash of the blob with the verb; None where the clips make no verb.
    size_bytes : int
        Of all blobs and the document.
    created_at_s, changed_at_s : float
        Seconds since 1970, UTC.
    """

    id: str
    revision: int
    name: str
    clips: int
    excluded: int
    archive: str
    motion: str
    artifact: str | None
    size_bytes: int
    created_at_s: float
    changed_at_s: float


class StoreError(Exception):
    """Root of the errors of the store."""


class BadAddress(StoreError):
    """An address of the database or the artifacts is not supported; the message lists the supported ones."""


class InvalidValue(StoreError):
    """A name, a text or a JSON value cannot be stored; the message states the limits."""


class UnknownVerb(StoreError):
    """The verb is not served, or was never published.

    Attributes
    ----------
    verb : str
    known : tuple of str
        Names of the served verbs.
    """

    def __init__(self, verb: str, known: Iterable[str]) -> None:
        self.verb, self.known = verb, tuple(known)
        super().__init__(f"unknown verb '{verb}'; known: {_listed(self.known)}")


class UnknownVersion(StoreError):
    """The verb has no such version, or it was removed.

    Attributes
    ----------
    verb : str
    number : int
    known : tuple of int
        Existing numbers.
    """

    def __init__(self, verb: str, number: int, known: Iterable[int]) -> None:
        self.verb, self.number, self.known = verb, number, tuple(known)
        super().__init__(f"verb '{verb}' has no version {number}; known: {_listed(self.known)}")


class UnknownJob(StoreError):
    """No refinement job has this ``id``."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"unknown refinement job '{id}'")


class JobExists(StoreError):
    """A refinement job with this ``id`` exists."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"refinement job '{id}' exists already")


class JobEnded(StoreError):
    """The job with this ``id`` has ended in ``state``, which is final."""

    def __init__(self, id: str, state: str) -> None:
        self.id, self.state = id, state
        super().__init__(f"refinement job '{id}' has ended ({state}); start another one")


class UnknownDraft(StoreError):
    """No draft has this ``id``."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"unknown draft '{id:.64}'")


class DraftChanged(StoreError):
    """The draft with this ``id`` has the revision ``found``, not ``expected``."""

    def __init__(self, id: str, expected: int, found: int) -> None:
        self.id, self.expected, self.found = id, expected, found
        super().__init__(f"draft '{id}' has revision {found}, not {expected}: read it again")


class TooManyDrafts(StoreError):
    """The limit of drafts, or of their bytes, is reached."""

    def __init__(self, limit: int, what: str) -> None:
        self.limit = limit
        super().__init__(f"the store may hold {limit} {what}; publish and delete some, or raise the limit")


class UnknownKey(StoreError):
    """No key has this ``id``."""

    def __init__(self, id: str) -> None:
        self.id = id
        super().__init__(f"unknown key '{id:.64}'; `adverb keys list` shows the existing ones")


class TooManyKeys(StoreError):
    """The limit of keys is reached."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        super().__init__(f"the store may hold {limit} keys that are neither revoked nor expired; revoke some")


class Conflict(StoreError):
    """Another version is current than expected.

    Attributes
    ----------
    verb : str
    expected, found : int
        Version numbers; 0 for none.
    """

    def __init__(self, verb: str, expected: int, found: int) -> None:
        self.verb, self.expected, self.found = verb, expected, found
        current = f"version {found}" if found else "no version"
        super().__init__(f"{current} of verb '{verb}' is current, not {expected or 'none'}: read it again")


class ArtifactMissing(StoreError):
    """The blob named ``sha256`` is missing or damaged."""

    def __init__(self, sha256: str, problem: str) -> None:
        self.sha256 = sha256
        super().__init__(f"artifact {sha256[:12]}… {problem}")


class ArtifactDamaged(ArtifactMissing):
    """The bytes of the blob do not match its hash."""


class StoreUnavailable(StoreError):
    """The database or the artifacts cannot be reached; ``reason`` is short and contains no secrets."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the store is unavailable: {reason}")


def _listed(known: tuple[Any, ...]) -> str:
    more = ", …" if len(known) > MAX_LISTED else ""
    return (", ".join(str(name) for name in known[-MAX_LISTED:]) or "none") + more


def check_verb(name: str) -> str:
    """Validate the name of a verb; raises :class:`InvalidValue`."""
    if NAME.fullmatch(name) is None:
        raise InvalidValue(f"{name!r:.80} is not a verb name ({NAME.pattern})")
    return name


def check_text(what: str, text: str, limit: int, *, empty: bool = True) -> str:
    """Validate a text for a row; raises :class:`InvalidValue`."""
    if len(text) > limit or not (text or empty):
        raise InvalidValue(f"'{what}' must have {0 if empty else 1} to {limit} characters; it has {len(text)}")
    if "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text):
        raise InvalidValue(f"'{what}' has a character that cannot be stored")
    return text


def json_text(what: str, value: Mapping[str, Any]) -> str:
    """A mapping as JSON of bounded length; raises :class:`InvalidValue`."""
    try:
        text = json.dumps(dict(value), allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError, RecursionError) as err:
        raise InvalidValue(f"'{what}' is not a JSON object: {err}") from err
    if len(text) > MAX_JSON_BYTES:
        raise InvalidValue(f"'{what}' may be {MAX_JSON_BYTES} bytes of JSON; it is {len(text)}")
    return text
