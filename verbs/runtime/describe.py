"""Verbs and poses as plain JSON values: what ``adverb … --json`` prints and what the REST routes answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from verbs.adverb_measure import FORMS
from verbs.blend import methods
from verbs.contacts import PARTS, Contacts
from verbs.conventions import F64, I64
from verbs.domain import describe as domain_text
from verbs.errors import OutOfRange, UnknownName
from verbs.goal import Goal
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.runtime.evaluate import Evaluator, Poses
from verbs.skeleton import Skeleton
from verbs.units import SI_UNITS
from verbs.verb import Domain, Measure, Verb

__all__ = [
    "SPACES", "describe", "joint_indices", "numbers", "own_measure_text", "pose_fields", "pose_record", "summary",
]  # fmt: skip

SPACES = ("local", "global")
"""Spaces of rotations in requests."""

_CHARTS = {number: name for name, number in charts.CHARTS.items()}
_MEASURES = {number: name for name, number in measures.MEASURES.items()}


def describe(verb: Verb, *, version: int = 1) -> dict[str, Any]:
    """Everything a client needs about a verb, as JSON values.

    Parameters
    ----------
    verb : Verb
    version : int
        Its number where it is served.
    """
    return {
        "name": verb.name,
        "version": version,
        "description": verb.description,
        "looping": verb.looping,
        "adverbs": [_adverb(verb, k) for k in range(len(verb.adverbs))],
        "skeleton": _skeleton(verb.skeleton),
        "examples": _examples(verb),
        "pseudo_examples": _pseudo_examples(verb),
        "keytime_names": list(verb.keytime_names),
        "keytime_phases": verb.phases.tolist(),
        "duration": _durations(verb),
        "domain": _domain(verb, verb.domain),
        "methods": list(methods.usable(verb)),
        "default_method": methods.default_method(verb),
        "measure": _measure(verb, verb.measure),
        "contacts": _contacts(verb.skeleton, verb.contacts),
        "quality": dict(verb.quality),
    }


def summary(verb: Verb, *, version: int = 1) -> dict[str, Any]:
    """One line of a list of verbs, as JSON values."""
    return {
        "name": verb.name,
        "version": version,
        "description": verb.description,
        "looping": verb.looping,
        "adverbs": [adverb.name for adverb in verb.adverbs],
        "joints": len(verb.skeleton),
        "examples": len(verb.examples),
        "duration": _durations(verb),
        "default_method": methods.default_method(verb),
    }


def pose_record(
    evaluator: Evaluator,
    poses: Poses,
    index: int,
    *,
    version: int = 1,
    space: str = "local",
    joints: Sequence[str] | None = None,
    weights: bool = False,
) -> dict[str, Any]:
    """One pose of a batch, as plain JSON values.

    Parameters
    ----------
    evaluator : Evaluator
        The one that made the poses.
    poses : Poses
    index : int
        Row of the batch.
    version : int
        The verb's number where it is served.
    space : str
        One of :data:`SPACES`; ``"global"`` adds the joints' positions.
    joints : sequence of str, optional
        Joints to give, in this order; all by default.
    weights : bool
        Whether to give the examples' weights too.

    Raises
    ------
    UnknownName
        A joint or a space that does not exist.
    """
    chosen = joint_indices(evaluator.verb.skeleton, joints)
    rotations, positions = in_space(evaluator, poses, space, chosen)
    support = evaluator.support(poses.blend)
    record = pose_fields(
        evaluator, poses, index, rotations, positions, support=support, version=version, weights=weights
    )
    return {key: _plain(value) if isinstance(value, np.ndarray) else value for key, value in record.items()}


def in_space(
    evaluator: Evaluator, poses: Poses, space: str, joints: I64 | None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32] | None]:
    """Rotations (B, J, 4) in a space and, in the global one, positions (B, J, 3), of some joints or (None) of all."""
    if space not in SPACES:
        raise UnknownName("space", space, SPACES)
    rotations, positions = evaluator.positions(poses) if space == "global" else (poses.rotations, None)
    if joints is not None:
        rotations, positions = rotations[:, joints], None if positions is None else positions[:, joints]
    return rotations.astype(np.float32), None if positions is None else positions.astype(np.float32)


def pose_fields(
    evaluator: Evaluator,
    poses: Poses,
    index: int,
    rotations: npt.NDArray[np.float32],
    positions: npt.NDArray[np.float32] | None,
    *,
    support: F64 | None,
    version: int,
    weights: bool,
) -> dict[str, Any]:
    """One pose of a batch; arrays stay float32 arrays, for encoders that take them as they are.

    ``rotations`` (B, J, 4) and ``positions`` (B, J, 3) are those of :func:`in_space`, ``support`` (B,) or (1,) that of
    the blend; None leaves it out.
    """
    verb, blend = evaluator.verb, poses.blend
    row = index if len(blend.weights) > 1 else 0  # one blend may serve many instants
    measured = blend.measured[row].tolist()
    record: dict[str, Any] = {
        "verb": verb.name,
        "version": version,
        "method": blend.method,
        "phase": float(poses.phase[index]),
        "time": float(poses.time_s[index]),
        "duration": float(poses.duration_s[index]),
        "root": poses.root[index].astype(np.float32),
        "rotations": rotations[index],
        "measured": dict(zip(evaluator.measured_names, measured, strict=True)),
        "error": number(float(blend.error[row])),
        "clamped": bool(blend.clamped[row]),
    }
    if support is not None:
        record["support"] = float(support[row])
    if positions is not None:
        record["positions"] = positions[index]
    if poses.root_velocity is not None:
        record["root_velocity"] = poses.root_velocity[index].astype(np.float32)
    if weights:
        record["weights"] = blend.weights[row]
    return record


def joint_indices(skeleton: Skeleton, joints: Sequence[str] | None) -> I64 | None:
    """Indices of joints by name; None for all. Raises :class:`UnknownName`, or :class:`OutOfRange` for no joint."""
    if joints is None:
        return None
    if not 1 <= len(joints) <= len(skeleton):
        raise OutOfRange(f"name 1 to {len(skeleton)} joints, or leave 'joints' out for all; {len(joints)} are named")
    return np.array([skeleton.index(name) for name in joints], np.int64)


def number(value: float) -> float | None:
    """A float for JSON: None where it is not finite."""
    return value if math.isfinite(value) else None


def numbers(values: F64) -> list[float | None]:
    """Floats for JSON."""
    return [number(value) for value in values.tolist()]


def _plain(array: npt.NDArray[Any]) -> Any:
    """Nested lists; a float32 becomes the shortest decimal that stands for it, as in the server's JSON."""
    if array.dtype == np.float32:
        return np.array([float(str(value)) for value in array.ravel()]).reshape(array.shape).tolist()
    return array.tolist()


def _adverb(verb: Verb, k: int) -> dict[str, Any]:
    adverb = verb.adverbs[k]
    return {
        "name": adverb.name,
        "unit": adverb.unit,
        "min": adverb.minimum,
        "max": adverb.maximum,
        "style": adverb.style,
        "description": adverb.description,
        "measure": _own_measure(verb, k),
    }


def _own_measure(verb: Verb, k: int) -> dict[str, Any] | None:
    """The measure that an adverb names for itself; None where the verb's measure is for all of them, or it has none.

    ``joint`` is null where none counts, ``at`` and ``between`` where the instants are no keytimes; ``spans`` has all.
    """
    axes = verb.measure.axes.tolist()
    if not verb.measure.rows or k not in axes:
        return None
    row = verb.measure.rows[axes.index(k)]
    spans = [
        {"joint": verb.skeleton.names[one.joint], "begin": one.begin, "end": one.begin if one.end is None else one.end}
        for one in row.spans
    ]
    alone, jointed = len(spans) == 1, FORMS[row.kind].joint or row.kind == "foot_speed"
    begin, end = (_keytime_name(verb, spans[0][key]) for key in ("begin", "end"))
    single = row.spans[0].end is None or row.kind == "time_to"
    return {
        "kind": row.kind,
        "axis": row.axis,
        "joint": spans[0]["joint"] if jointed and alone else None,
        "at": end if single and alone else None,
        "between": [begin, end] if not single and alone and begin and end else None,
        "unit": SI_UNITS[row.dimension],
        "spans": spans,
    }


def _keytime_name(verb: Verb, phase: float) -> str | None:
    """Name of the keytime at a phase."""
    found = np.flatnonzero(np.abs(verb.phases - phase) < 1e-9)
    return verb.keytime_names[int(found[0])] if len(found) else None


def own_measure_text(verb: Verb, k: int) -> str:
    """The measure of an adverb in a few words; empty where it names none."""
    found = _own_measure(verb, k)
    if found is None:
        return ""
    place = f" of {found['joint']}" if found["joint"] else ""
    axis = "" if found["axis"] in (found["kind"], "speed", "time") else f" {found['axis']}"
    if found["at"]:
        return f"{found['kind']}{axis}{place} at {found['at']}"
    when = f" between {' and '.join(found['between'])}" if found["between"] else " while feet stand"
    return f"{found['kind']}{axis}{place}{when}"


def _examples(verb: Verb) -> list[dict[str, Any]]:
    """Examples, with the point of the verb's space of each where the measure is a position."""
    points = _points(verb, verb.values)
    return [
        {
            "name": name,
            "adverbs": _named(verb, verb.values[k]),
            "keytimes": verb.keytimes[k].tolist(),
            "point": points[k],
        }
        for k, name in enumerate(verb.examples)
    ]


def _pseudo_examples(verb: Verb) -> list[dict[str, Any]]:
    """Where refinements for error and for quality put pseudo-examples."""
    rows: list[dict[str, Any]] = []
    for name, aim in (("refined", "error"), ("smooth", "quality")):
        if name in verb.bases:
            basis = verb.bases[name]
            values = basis.chart.adverbs(basis.centers[len(verb.examples) :])
            pairs = zip(values, _points(verb, values), strict=True)
            rows += [{"adverbs": _named(verb, row), "point": point, "for": aim} for row, point in pairs]
    return rows


def _named(verb: Verb, row: F64) -> dict[str, float]:
    return dict(zip((adverb.name for adverb in verb.adverbs), row.tolist(), strict=True))


def _points(verb: Verb, values: F64) -> list[list[float] | None]:
    """Points (x, y, z), metres, of adverbs (B, D): where the effector is, or where a jump lands at how much rise."""
    points = Goal.of_verb(verb).points(values)
    if verb.measure.kind == measures.POSITION:
        return list(points.tolist())
    if verb.measure.kind == measures.JUMP:
        return list(points[:, [0, 2, 1]].tolist())  # x, z and rise → x, rise, z
    return [None] * len(values)


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    tips = zip(skeleton.tip_parents.tolist(), skeleton.tip_offsets.tolist(), strict=True)
    return {
        "names": list(skeleton.names),
        "parents": skeleton.parents.tolist(),
        "offsets": skeleton.offsets.tolist(),
        "tips": [{"parent": parent, "offset": offset} for parent, offset in tips],
    }


def _contacts(skeleton: Skeleton, contacts: Contacts | None) -> list[dict[str, Any]]:
    """Feet with their contact points: share of canonical time in contact, mean over examples, and intervals."""
    if contacts is None:
        return []
    feet = []
    for foot in dict.fromkeys(contacts.feet.tolist()):
        points = np.flatnonzero(contacts.feet == foot)
        any_point = contacts.values[:-1, :, points].max(axis=2)
        feet.append(
            {
                "foot": skeleton.names[foot],
                "share": _share(any_point),
                "intervals": int(np.isin(contacts.owners[:, 1], points).sum()),
                "points": [_contact_point(skeleton, contacts, int(p)) for p in points],
            }
        )
    return feet


def _contact_point(skeleton: Skeleton, contacts: Contacts, p: int) -> dict[str, Any]:
    return {
        "part": PARTS[contacts.parts[p]],
        "joint": skeleton.names[contacts.joints[p]],
        "offset": contacts.offsets[p].tolist(),
        "height": float(contacts.heights[:, p].mean()),
        "share": _share(contacts.values[:-1, :, p]),
        "intervals": [contacts.of(i, p).tolist() for i in range(contacts.values.shape[1])],
    }


def _share(values: npt.NDArray[np.float32]) -> float:
    """Mean of contact values, to four digits."""
    return round(float(values.mean(dtype=np.float64)), 4)


def _durations(verb: Verb) -> dict[str, float]:
    """Shortest and longest example, seconds."""
    ends = verb.keytimes[:, -1] - verb.keytimes[:, 0]
    return {"min": float(ends.min()), "max": float(ends.max())}


def _domain(verb: Verb, domain: Domain) -> dict[str, Any]:
    """The hull {u : facets · (u - middle) ≤ 1}, u = (chart(adverbs) - shift) · scale, and words for it."""
    chart = domain.chart
    return {
        "text": domain_text(verb),
        "chart": _CHARTS[chart.kind],
        "chart_axes": chart.axes.tolist(),
        "chart_bend": chart.bend.tolist(),
        "shift": chart.shift.tolist(),
        "scale": chart.scale.tolist(),
        "facets": domain.facets.tolist(),
        "middle": domain.middle.tolist(),
    }


def _measure(verb: Verb, measure: Measure) -> dict[str, Any]:
    position = measure.kind == measures.POSITION
    return {
        "kind": _MEASURES[measure.kind],
        "effector": verb.skeleton.names[measure.effector] if position else None,
        "keytime": verb.keytime_names[measure.keytime] if position else None,
        "adverbs": [verb.adverbs[axis].name for axis in measure.axes.tolist()] if measure.kind else [],
        "unit": measure.unit,
        "origin": measure.origin.tolist() if position else None,
        "frame": measure.frame.tolist() if position else None,
    }
