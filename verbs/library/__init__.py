"""Built-in verbs, each with its source and its artifact."""

from __future__ import annotations

from pathlib import Path

from verbs.errors import UnknownName
from verbs.io import artifact
from verbs.verb import Verb

__all__ = ["load", "names", "source"]

_FOLDER = Path(__file__).parent


def names() -> tuple[str, ...]:
    """Names of the built-in verbs, in order."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.verb")))


def load(name: str) -> Verb:
    """Load a built-in verb; raises :class:`UnknownName` with the names that exist."""
    if name not in names():
        raise UnknownName("verb", name, names())
    return artifact.load(_FOLDER / f"{name}.verb")


def source(name: str) -> Path:
    """Folder of a built-in verb's source."""
    if name not in names():
        raise UnknownName("verb", name, names())
    return _FOLDER / name
