"""The served verbs, built-in ones and those of a folder, prepared for evaluation."""

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
from verbs.mapping.mapper import Mapper
from verbs.runtime import describe, sequence
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["Catalog", "Entry", "Skipped", "files_of", "load", "problem_of", "skipped"]

MAX_SUBSETS = 64
"""Largest number of cached joint subsets per entry; a client uses one or two."""

log = structlog.get_logger("adverb.catalog")


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One version of a verb, prepared for evaluation.

    Parameters
    ----------
    verb : Verb
    evaluator : Evaluator
    version : int
        Counts from 1.
    path : Path
        File of the artifact.
    description : bytes
        Response of ``GET /v1/verbs/{verb}``, encoded once as it never changes.
    etag : str
        ETag of the description, quoted as in HTTP.
    span_s : tuple of float
        Durations of the shortest and the longest example, seconds.
    methods : tuple of str
        Methods of the verb.
    mappers : dict
        By name and goal: mappings to other skeletons that were requested.
    """

    verb: Verb = field(repr=False)
    evaluator: Evaluator = field(repr=False)
    version: int
    path: Path
    description: bytes = field(repr=False)
    etag: str
    span_s: tuple[float, float]
    methods: tuple[str, ...]
    mappers: dict[tuple[str, str], Mapper] = field(default_factory=dict, repr=False)
    _subsets: dict[tuple[str, ...], I64] = field(default_factory=dict, repr=False)

    @classmethod
    def of_verb(cls, verb: Verb, *, path: Path, version: int = 1) -> Entry:
        """Prepare a verb, and compile all kernels that requests may need."""
        evaluator = Evaluator(verb)
        facts = describe.describe(verb, version=version)
        _warm(evaluator)
        text = orjson.dumps(facts, option=orjson.OPT_SERIALIZE_NUMPY)
        lengths = verb.keytimes[:, -1] - verb.keytimes[:, 0]
        span = (float(lengths.min()), float(lengths.max()))
        etag = f'"{hashlib.sha256(text).hexdigest()[:32]}"'
        return cls(verb, evaluator, version, path, text, etag, span, tuple(facts["methods"]))

    def check(self, *, method: str | None) -> None:
        """Raise :class:`UnknownName` if the verb does not have a method."""
        if method is not None and method not in self.methods:
            raise UnknownName("method", method, self.methods)

    def joints(self, names: Iterable[str] | None) -> I64 | None:
        """Indices of joints by name, cached; None for all joints."""
        if names is None:
            return None
        key = tuple(names)
        found = self._subsets.get(key)
        if found is None:
            chosen = describe.joint_indices(self.verb.skeleton, key)
            assert chosen is not None  # only None gives None
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
        """Estimated time of evaluating poses, µs; ``cycles`` is the sum of integrated cycles of all poses."""
        examples, joints = len(self.verb.examples), len(self.verb.skeleton)
        return rows * (3.0 + 0.008 * examples * joints) + cycles * 0.015 * len(self.verb.strides) * examples


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file of the data folder that is not served, and the reason."""

    file: str
    problem: str


@dataclass(frozen=True, slots=True, eq=False)
class Catalog:
    """The served verbs; immutable, so a change is a new catalog.

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
    """Compile or load every kernel that a route may need, so that no request waits for one."""
    evaluator.warm()
    sequence.tracked(evaluator, np.zeros(1), evaluator.verb.values[:1], 1.0)
    Characters(evaluator).warm()


def files_of(data: Path | None) -> list[Path]:
    """Files of the built-in verbs, then those of a folder."""
    builtin = [Path(library.__file__).with_name(f"{name}.verb") for name in library.names()]
    return [*builtin, *sorted(data.glob("*.verb") if data else ())]


def problem_of(err: Exception) -> str:
    """Why a file cannot be served, without its path, as clients read it."""
    return str(getattr(err, "problem", err)) or type(err).__name__


def skipped(path: Path, err: Exception) -> Skipped:
    """Log and report a file that cannot be served."""
    problem = problem_of(err)
    log.error("verb file skipped", file=str(path), problem=problem, kind=type(err).__name__)
    return Skipped(path.name, problem)


def load(data: Path | None) -> Catalog:
    """Load the built-in verbs and those of a folder; files that cannot be served are logged and skipped.

    A verb of the folder replaces a built-in one of the same name. Of two files with the same verb the first, in order
    of file names, is served.
    """
    entries: dict[str, Entry] = {}
    wrong: list[Skipped] = []
    for path in files_of(data):
        try:
            entry = Entry.of_verb(artifact.load(path), path=path)
            before = entries.get(entry.verb.name)
            if before is not None and before.path.parent == path.parent:
                raise RequestError(f"its verb '{entry.verb.name}' is already served from {before.path.name}")
        except Exception as err:  # one invalid file must not affect the others
            wrong.append(skipped(path, err))
            continue
        if before is not None:
            log.warning("built-in verb replaced", verb=entry.verb.name, file=str(path))
        entries[entry.verb.name] = entry
        log.debug("verb loaded", verb=entry.verb.name, file=str(path), etag=entry.etag)
    return Catalog(MappingProxyType(dict(sorted(entries.items()))), tuple(wrong))
