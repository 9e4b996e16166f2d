"""Save and load ``.verb`` files: one safetensors file, memory-mapped and checked.

The layout is documented in ``docs/artifact.md``.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save as serialize

from verbs.adverb_measure import AdverbMeasure, Span
from verbs.contacts import Contacts
from verbs.conventions import F64, MAX_ADVERBS, MAX_KEYS, MAX_MAGNITUDE
from verbs.errors import ArtifactCorrupt, ArtifactError, ArtifactVersionError, VerbError
from verbs.kernels import measure as measures
from verbs.skeleton import Skeleton
from verbs.verb import Adverb, Basis, Chart, Domain, Measure, Verb

__all__ = ["FORMAT", "load", "save"]

FORMAT = 2
"""Newest version of the layout. A reader refuses newer ones; older ones stay readable. A file states the least version
that reads it right: 2 where a jump or speeds have adverbs in other units than SI, otherwise 1."""

MAX_HEADER_BYTES = 16 * 1024 * 1024
MAX_BYTES = 4 * 1024 * 1024 * 1024

_DTYPES: dict[str, np.dtype[Any]] = {"F32": np.dtype("<f4"), "F64": np.dtype("<f8"), "I64": np.dtype("<i8")}

_CONTACTS = ("feet", "joints", "parts", "offsets", "heights", "values", "intervals", "owners")
"""Arrays of contacts; a file has all of them or none."""

Arrays = dict[str, np.ndarray[Any, Any]]


def save(verb: Verb, path: str | Path) -> None:
    """Write a verb to a file, atomically. The same verb gives the same bytes.

    Parameters
    ----------
    verb : Verb
    path : str or Path

    Raises
    ------
    ArtifactError
        The file cannot be written.
    """
    target = Path(path)
    arrays = _arrays(verb)
    facts = _facts(verb)
    text = _text(facts | {"sha256": _digest(arrays, facts)})
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        with part.open("wb") as file:
            file.write(serialize(arrays, metadata={"adverb": text}))
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as err:
        raise ArtifactError(target, f"cannot be written: {err.strerror or err}") from err
    finally:
        part.unlink(missing_ok=True)


def load(path: str | Path) -> Verb:
    """Load a ``.verb`` file: map it and check all of it.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    verb : Verb
        Its arrays are read-only views of the mapped file.

    Raises
    ------
    ArtifactVersionError
        It was written in a newer format.
    ArtifactCorrupt
        It is not a verb, is truncated, or was changed after it was written.
    ArtifactError
        It cannot be opened.
    """
    path = Path(path)
    arrays, facts = _map(path)
    version = facts.get("format")
    if not isinstance(version, int) or version < 1:
        raise ArtifactCorrupt(path, f"its format is {version!r:.40}, not a positive integer")
    if version > FORMAT:
        raise ArtifactVersionError(path, f"has format {version}; this Adverb reads up to {FORMAT}: upgrade it")
    try:
        intact = facts.pop("sha256", None) == _digest(arrays, facts)
    except (ValueError, RecursionError) as err:  # numbers that are not finite, half of a surrogate pair, deep nesting
        raise ArtifactCorrupt(path, f"has an invalid header: {type(err).__name__}") from err
    if not intact:
        raise ArtifactCorrupt(path, "its checksum does not match; copy or build it again")
    try:
        return _verb(arrays, facts)
    except (VerbError, KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as err:
        raise ArtifactCorrupt(path, f"does not describe a verb: {err}") from err


def _facts(verb: Verb) -> dict[str, Any]:
    """All metadata, as JSON values."""
    skeleton, measure = verb.skeleton, verb.measure
    return {
        "format": _format(verb),
        "name": verb.name,
        "description": verb.description,
        "looping": verb.looping,
        "joints": list(skeleton.names),
        "adverbs": [
            {"name": a.name, "unit": a.unit, "description": a.description, "style": a.style} for a in verb.adverbs
        ],
        "ranges": [[a.minimum, a.maximum] for a in verb.adverbs],
        "examples": list(verb.examples),
        "keytime_names": list(verb.keytime_names),
        "rotation_mode": verb.rotation_mode,
        "root_motion": verb.root_motion,
        "measure": {
            "kind": measures.NOTHING if measure.rows else measure.kind,
            "effector": measure.effector,
            "keytime": measure.keytime,
        },
        **({"measured": [_measured(*pair) for pair in _pairs(measure)]} if measure.rows else {}),
        "domain": {"chart": verb.domain.chart.kind, "sharpness": verb.domain.sharpness},
        "bases": {
            name: {
                "chart": basis.chart.kind,
                "kernel": basis.radial_basis,
                "degree": basis.degree,
                "condition": basis.condition,
            }
            for name, basis in sorted(verb.bases.items())
        },
        "quality": verb.quality,
        "provenance": verb.provenance,
    }


def _pairs(measure: Measure) -> list[tuple[int, AdverbMeasure]]:
    return list(zip(measure.axes.tolist(), measure.rows, strict=True))


def _measured(axis: int, row: AdverbMeasure) -> dict[str, Any]:
    """The measure of one adverb, as JSON values; readers without it find a verb without a measure."""
    return {
        "adverb": axis,
        "kind": row.kind,
        "axis": row.axis,
        "spans": [[span.joint, span.begin] + [span.end] * (span.end is not None) for span in row.spans],
        "factor": row.factor,
        "center": row.center,
        "base": list(row.base),
    }


def _format(verb: Verb) -> int:
    """Least version of the layout that a verb needs: readers of 1 take a jump's and a walk's adverbs to be in SI."""
    measure = verb.measure
    direct = measure.kind in (measures.JUMP, measures.VELOCITY)
    return 2 if direct and not np.array_equal(measure.frame, np.eye(3)) else 1


def _arrays(verb: Verb) -> Arrays:
    skeleton, measure = verb.skeleton, verb.measure
    arrays: Arrays = {
        "curves": verb.curves,
        "keytimes": verb.keytimes,
        "measure.axes": measure.axes[:0] if measure.rows else measure.axes,
        "measure.frame": measure.frame[:, :0] if measure.rows else measure.frame,
        "measure.origin": measure.origin,
        "phases": verb.phases,
        "references": verb.references,
        "skeleton.offsets": skeleton.offsets,
        "skeleton.parents": skeleton.parents,
        "skeleton.tip_offsets": skeleton.tip_offsets,
        "skeleton.tip_parents": skeleton.tip_parents,
        "strides": verb.strides[:, :, :3],
        "values": verb.values,
        "domain.facets": verb.domain.facets,
        "domain.middle": verb.domain.middle,
    }
    if verb.strides[:, :, 3].any():
        arrays["rises"] = verb.strides[:, :, 3]
    arrays |= _chart_arrays("domain", verb.domain.chart)
    for name, basis in verb.bases.items():
        prefix = f"bases.{name}"
        arrays |= {f"{prefix}.{key}": getattr(basis, key) for key in ("centers", "radii", "radial", "poly")}
        arrays |= _chart_arrays(prefix, basis.chart)
    if verb.contacts is not None:
        arrays |= {f"contacts.{key}": getattr(verb.contacts, key) for key in _CONTACTS}
    return {name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())}


def _chart_arrays(prefix: str, chart: Chart) -> Arrays:
    return {f"{prefix}.chart.{key}": getattr(chart, key) for key in ("axes", "bend", "shift", "scale")}


def _text(facts: dict[str, Any]) -> str:
    """Canonical JSON text of the facts."""
    return json.dumps(facts, sort_keys=True, ensure_ascii=False, allow_nan=False)


def _digest(arrays: Mapping[str, np.ndarray[Any, Any]], facts: dict[str, Any]) -> str:
    """SHA-256 over the facts' text, then names, types, shapes and bytes of all arrays in order of their names."""
    digest = hashlib.sha256(_text(facts).encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\n{name}:{array.dtype.str}:{array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()


def _map(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """Read-only views of a safetensors file's arrays, and the facts in its header."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if not 16 <= size <= MAX_BYTES:
                raise ArtifactCorrupt(path, f"is {size} bytes long, which is not a valid size")
            block = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as err:
        raise ArtifactError(path, f"cannot be opened: {err.strerror or err}") from err
    length = int.from_bytes(block[:8], "little")
    if not 2 <= length <= min(MAX_HEADER_BYTES, size - 8):
        raise ArtifactCorrupt(path, "is not a safetensors file")
    try:
        header = json.loads(block[8 : 8 + length].decode("utf-8"))
        facts = json.loads(header.pop("__metadata__")["adverb"])
        arrays = _views(path, block, 8 + length, header)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
        raise ArtifactCorrupt(path, f"has an invalid header: {type(err).__name__}") from err
    if not isinstance(facts, dict):
        raise ArtifactCorrupt(path, "has an invalid header")
    return arrays, facts


def _views(path: Path, block: mmap.mmap, start: int, header: dict[str, Any]) -> Arrays:
    arrays: Arrays = {}
    space = len(block) - start
    for name, entry in header.items():
        if entry["dtype"] not in _DTYPES:
            raise ArtifactCorrupt(path, f"array '{name}' has the type {entry['dtype']!r:.20}")
        dtype, shape = _DTYPES[entry["dtype"]], tuple(entry["shape"])
        begin, end = entry["data_offsets"]
        if len(shape) > 4 or not all(type(side) is int and 0 <= side <= 1 << 32 for side in (*shape, begin, end)):
            raise ArtifactCorrupt(path, f"array '{name}' has an impossible shape")
        count = int(np.prod(shape, dtype=object))
        if end - begin != count * dtype.itemsize or not 0 <= begin <= end <= space or (start + begin) % dtype.itemsize:
            raise ArtifactCorrupt(path, f"array '{name}' does not fit into the file")
        array = np.frombuffer(block, dtype, count, start + begin).reshape(shape)
        if dtype.kind == "f" and not np.isfinite(array).all():
            raise ArtifactCorrupt(path, f"array '{name}' holds a number that is not finite")
        arrays[name] = array
    return arrays


def _chart(arrays: Arrays, prefix: str, kind: int) -> Chart:
    names = ("axes", "bend", "shift", "scale")
    return Chart(kind, *(arrays[f"{prefix}.chart.{name}"] for name in names))


def _basis(arrays: Arrays, name: str, facts: dict[str, Any]) -> Basis:
    prefix = f"bases.{name}"
    return Basis(
        chart=_chart(arrays, prefix, facts["chart"]),
        radial_basis=facts["kernel"],
        degree=facts["degree"],
        condition=facts["condition"],
        **{key: arrays[f"{prefix}.{key}"] for key in ("centers", "radii", "radial", "poly")},
    )


def _strides(arrays: Arrays) -> F64:
    """Steps (K, N, 4) of planar steps (K, N, 3) and rises (K, N), which are stored where a verb climbs."""
    planar = arrays["strides"]
    rises = arrays.get("rises", np.zeros(planar.shape[:2]))
    return np.concatenate([planar, rises[:, :, None]], axis=2)


def _contacts(arrays: Arrays) -> Contacts | None:
    if not any(name.startswith("contacts.") for name in arrays):
        return None
    return Contacts(**{key: arrays[f"contacts.{key}"] for key in _CONTACTS})


def _measure(arrays: Arrays, facts: dict[str, Any]) -> Measure:
    fields: dict[str, Any] = {key: arrays[f"measure.{key}"] for key in ("axes", "origin", "frame")}
    measure = Measure(**facts["measure"], **fields)
    if "measured" not in facts:
        return measure
    rows = facts["measured"]
    if measure.kind != measures.NOTHING or not isinstance(rows, list) or not 1 <= len(rows) <= MAX_ADVERBS:
        raise ValueError("measured adverbs")
    axes = np.array([_integer(row["adverb"]) for row in rows], np.int64)
    own = tuple(_own(row) for row in rows)
    return Measure(measures.ADVERBS, measure.effector, -1, axes, np.zeros(3), np.zeros((3, len(rows))), own)


def _own(row: dict[str, Any]) -> AdverbMeasure:
    """The measure of one adverb; its values are checked with the verb."""
    spans = []
    for span in row["spans"]:
        joint, begin, *end = span
        spans.append(Span(_integer(joint), _number(begin), *map(_number, end)))
    x, y, z, w = map(_number, row["base"])
    if not isinstance(row["kind"], str) or not isinstance(row["axis"], str):
        raise TypeError("the kind and axis of a measure are texts")
    return AdverbMeasure(
        row["kind"], row["axis"], tuple(spans), _number(row["factor"]), _number(row["center"]), (x, y, z, w)
    )


def _integer(value: Any) -> int:
    if type(value) is not int or abs(value) > MAX_KEYS:
        raise TypeError(f"{value!r:.40} is no index")
    return value


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not abs(value) <= MAX_MAGNITUDE:
        raise TypeError(f"{value!r:.40} is no number")
    return float(value)


def _verb(arrays: Arrays, facts: dict[str, Any]) -> Verb:
    skeleton = Skeleton(
        tuple(facts["joints"]),
        arrays["skeleton.parents"],
        arrays["skeleton.offsets"],
        arrays["skeleton.tip_parents"],
        arrays["skeleton.tip_offsets"],
    )
    adverbs = tuple(
        Adverb(row["name"], row["unit"], row["description"], row["style"], *map(float, span))
        for row, span in zip(facts["adverbs"], facts["ranges"], strict=True)
    )
    measure = _measure(arrays, facts)
    domain = Domain(
        _chart(arrays, "domain", facts["domain"]["chart"]),
        arrays["domain.facets"],
        arrays["domain.middle"],
        facts["domain"]["sharpness"],
    )
    return Verb(
        name=facts["name"],
        description=facts["description"],
        looping=facts["looping"],
        skeleton=skeleton,
        adverbs=adverbs,
        examples=tuple(facts["examples"]),
        values=arrays["values"],
        keytime_names=tuple(facts["keytime_names"]),
        keytimes=arrays["keytimes"],
        phases=arrays["phases"],
        curves=arrays["curves"],
        references=arrays["references"],
        rotation_mode=facts["rotation_mode"],
        root_motion=facts["root_motion"],
        strides=_strides(arrays),
        measure=measure,
        domain=domain,
        bases={name: _basis(arrays, name, row) for name, row in facts["bases"].items()},
        quality=facts["quality"],
        provenance=facts["provenance"],
        contacts=_contacts(arrays),
    )
