"""The exceptions of the library, in one tree.

::

    VerbError
    ├── MotionFileError      a motion file is invalid (path, place, expected, found, advice)
    ├── SourceError          a verb source folder or its verb.toml is wrong (path, example, advice)
    ├── SkeletonMismatch     two motions or verbs do not share one skeleton
    ├── IllPosedVerb         the examples do not determine a verb (duplicates, too few, collinear)
    ├── RequestError         a request that cannot be answered
    │   ├── UnknownName      a verb, adverb, joint, method that does not exist (name, known)
    │   └── OutOfRange       a number that is not finite or not inside its bounds
    └── ArtifactError        a .verb file cannot be used (path)
        ├── ArtifactVersionError   it was written by a newer Adverb
        └── ArtifactCorrupt        its bytes are not a valid verb

The library raises these and nothing else for bad input; the service maps each to a status in one table.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

__all__ = [
    "ArtifactCorrupt",
    "ArtifactError",
    "ArtifactVersionError",
    "IllPosedVerb",
    "MotionFileError",
    "OutOfRange",
    "RequestError",
    "SkeletonMismatch",
    "SourceError",
    "UnknownName",
    "VerbError",
]


class VerbError(Exception):
    """Root of every error that this library raises for bad input."""


class MotionFileError(VerbError):
    """A motion file is invalid.

    Attributes
    ----------
    path : str
        The file, or ``"<text>"`` where the motion came from memory.
    line : int or None
        1-based line of the first thing that is wrong, in a file of text.
    place : str
        Where else it is, such as ``"accessors[3]"``; ``"line 5"`` where there is a line, empty where neither is known.
    expected, found : str
        What the format requires there, and what the file has.
    advice : str
        What to do about it; may be empty.
    """

    def __init__(self, path: str | Path, place: int | str | None, expected: str, found: str, advice: str = "") -> None:
        self.path, self.expected, self.found, self.advice = str(path), expected, found, advice
        self.line = place if isinstance(place, int) else None
        self.place = f"line {place}" if isinstance(place, int) else place or ""
        where = f"{path}:{place}" if isinstance(place, int) else f"{path}, {place}" if place else f"{path}"
        super().__init__(f"{where}: expected {expected}, found {found}" + (f"; {advice}" if advice else ""))


class SourceError(VerbError):
    """A verb source is wrong; the message names the file, the example and what to do."""

    def __init__(self, path: str | Path, problem: str, *, example: str | None = None) -> None:
        self.path, self.problem, self.example = str(path), problem, example
        where = f"{path}, example '{example}'" if example else f"{path}"
        super().__init__(f"{where}: {problem}")


class SkeletonMismatch(VerbError):
    """Two motions, or two verbs, do not share one skeleton."""


class IllPosedVerb(VerbError):
    """The examples do not determine a verb; the message names them and what to do."""


class RequestError(VerbError):
    """A request that cannot be answered."""


class UnknownName(RequestError):
    """A name that does not exist, with the names that do.

    Attributes
    ----------
    kind : str
        What was named: ``"verb"``, ``"adverb"``, ``"joint"``, ``"method"`` …
    name : str
        The name that was given.
    known : tuple of str
        The names that exist.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        listing = ", ".join(self.known) or "none"
        super().__init__(f"unknown {kind} '{name}'; known: {listing}")


class OutOfRange(RequestError):
    """A number that is not finite, or not inside its bounds."""


class ArtifactError(VerbError):
    """A ``.verb`` file cannot be used."""

    def __init__(self, path: str | Path, problem: str) -> None:
        self.path, self.problem = str(path), problem
        super().__init__(f"{path}: {problem}")


class ArtifactVersionError(ArtifactError):
    """A ``.verb`` file was written in a format that is newer than this Adverb."""


class ArtifactCorrupt(ArtifactError):
    """The bytes of a ``.verb`` file are not a valid verb."""
