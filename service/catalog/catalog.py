"""Which verbs are served: the built-in ones and those of a folder, each ready to be asked."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
import orjson
import structlog

from verbs import Characters, library
from verbs.conventions import I64
from verbs.errors import RequestError, UnknownName
from verbs.io import artifact
from verbs.runtime import describe, sequence
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["Catalog", "Entry", "Skipped", "files_of", "load", "skipped"]

MAX_SUBSETS = 64
"""Joint subsets that an entry remembers; a client uses one or two."""

log = structlog.get_logger("adverb.catalog")


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One version of a verb, ready to be asked.

    Parameters
    ----------
    verb : Verb
    evaluator : Evaluator
    version : int
        Counts from 1.
    path : Path
        The file that it came from.
    description : bytes
        What ``GET /v1/verbs/{verb}`` answers: it never changes, so it is written once.
    etag : str
        Names the description, quoted as in HTTP.
    span_s : tuple of float
        Durations of the shortest and the longest example, seconds.
    methods : tuple of str
        Methods that this verb can be asked with.
    """

    verb: Verb = field(repr=False)
    evaluator: Evaluator = field(repr=False)
    version: int
    path: Path
    description: bytes = field(repr=False)
    etag: str
    span_s: tuple[float, float]
    methods: tuple[str, ...]
    _subsets: dict[tuple[str, ...], I64] = field(default_factory=dict, repr=False)

    @classmethod
    def of_verb(cls, verb: Verb, *, path: Path, version: int = 1) -> Entry:
        """Make a verb ready: prepare and compile everything that a request may need."""
        evaluator = Evaluator(verb)
        facts = describe.describe(verb, version=version)
        _warm(evaluator)
        text = orjson.dumps(facts, option=orjson.OPT_SERIALIZE_NUMPY)
        lengths = verb.keytimes[:, -1] - verb.keytimes[:, 0]
        span = (float(lengths.min()), float(lengths.max()))
        etag = f'"{hashlib.sha256(text).hexdigest()[:32]}"'
        return cls(verb, evaluator, version, path, text, etag, span, tuple(facts["methods"]))

    def check(self, *, method: str | None) -> None:
        """Raise :class:`UnknownName` where a method is asked for that the verb does not have."""
        if method is not None and method not in self.methods:
            raise UnknownName("method", method, self.methods)

    def joints(self, names: Iterable[str] | None) -> I64 | None:
        """Indices of joints by name, remembered; None for all of them."""
        if names is None:
            return None
        key = tuple(names)
        found = self._subsets.get(key)
        if found is None:
            chosen = describe.joint_indices(self.verb.skeleton, key)
            assert chosen is not None  # None comes from None only
            if len(self._subsets) < MAX_SUBSETS:
                self._subsets[key] = chosen
            return chosen
        return found

    @property
    def shortest_s(self) -> float:
        """Duration of the shortest example, seconds."""
        return self.span_s[0]

    @property
    def longest_s(self) -> float:
        """Duration of the longest example, seconds."""
        return self.span_s[1]

    def cost_us(self, rows: int, cycles: float) -> float:
        """What evaluating poses takes, roughly, in µs; ``cycles`` are walked through, all poses together."""
        examples, joints = len(self.verb.examples), len(self.verb.skeleton)
        return rows * (3.0 + 0.008 * examples * joints) + cycles * 0.015 * len(self.verb.strides) * examples


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file of the data folder that is not served, and why."""

    file: str
    problem: str


@dataclass(frozen=True, slots=True, eq=False)
class Catalog:
    """The verbs that are served. It does not change; a change is another catalog.

    Parameters
    ----------
    entries : mapping of str to Entry
        By name, in order.
    skipped : tuple of Skipped
    """

    entries: Mapping[str, Entry] = field(default_factory=lambda: MappingProxyType({}))
    skipped: tuple[Skipped, ...] = ()

    def entry(self, name: str) -> Entry:
        """A verb by name; raises :class:`UnknownName` with the names that exist."""
        found = self.entries.get(name)
        if found is None:
            raise UnknownName("verb", name, self.entries)
        return found


def _warm(evaluator: Evaluator) -> None:
    """Compile or load every kernel that any route may need, so that no request waits for one."""
    evaluator.warm()
    sequence.tracked(evaluator, np.zeros(1), evaluator.verb.values[:1], 1.0)
    Characters(evaluator).warm()


def files_of(data: Path | None) -> list[Path]:
    """The built-in verbs' files, then those of a folder."""
    builtin = [Path(library.__file__).with_name(f"{name}.verb") for name in library.names()]
    return [*builtin, *sorted(data.glob("*.verb") if data else ())]


def skipped(path: Path, err: Exception) -> Skipped:
    """Log and tell that a file cannot be served."""
    problem = str(getattr(err, "problem", err)) or type(err).__name__  # without the path: clients read it
    log.error("verb file skipped", file=str(path), problem=problem, kind=type(err).__name__)
    return Skipped(path.name, problem)


def load(data: Path | None) -> Catalog:
    """Load the built-in verbs and those of a folder; what cannot be served is logged and left out.

    A verb of the folder takes the place of a built-in one of the same name. Of two files with one name the first,
    in order of file names, is served.
    """
    entries: dict[str, Entry] = {}
    wrong: list[Skipped] = []
    for path in files_of(data):
        try:
            entry = Entry.of_verb(artifact.load(path), path=path)
            before = entries.get(entry.verb.name)
            if before is not None and before.path.parent == path.parent:
                raise RequestError(f"its verb '{entry.verb.name}' is already served from {before.path.name}")
        except Exception as err:  # whatever is wrong with one file, the others are served
            wrong.append(skipped(path, err))
            continue
        if before is not None:
            log.warning("built-in verb replaced", verb=entry.verb.name, file=str(path))
        entries[entry.verb.name] = entry
        log.debug("verb loaded", verb=entry.verb.name, file=str(path), etag=entry.etag)
    return Catalog(MappingProxyType(dict(sorted(entries.items()))), tuple(wrong))
