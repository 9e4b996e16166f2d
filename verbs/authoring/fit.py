"""Build a verb from its source folder: checked, and the same bytes for the same source.

Stages: read → mend → check → align and warp → fit curves → solve the basis → measure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from verbs.adverb_measure import Span
from verbs.authoring import apex, basis, charts, curves
from verbs.authoring.measuring import measure_of
from verbs.authoring.mending import mended
from verbs.authoring.own_measures import centred, needs_stances, stances_of
from verbs.authoring.reading import Progress, read_motions
from verbs.authoring.source import TAILS, Source, SourceExample, read
from verbs.authoring.stated_contacts import contacts_of
from verbs.blend.methods import default_method
from verbs.conventions import F64
from verbs.domain import describe, random_points
from verbs.errors import IllPosedVerb, SourceError
from verbs.goal import Goal, diagonal
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.motion import Motion
from verbs.runtime.evaluate import Evaluator
from verbs.units import quantity
from verbs.verb import Adverb, Chart, Measure, Verb

__all__ = ["Assembled", "Built", "assemble", "build"]

KEYTIME_SLACK_S = 1e-3
"""A last keytime may lie this far past the end of its file: files round both numbers."""

ADVERB_TOLERANCE = 0.005
"""Stored adverbs whose goal is farther than this (m, or m/s) from the measured point are reported."""

QUALITY_POINTS = 1_000

IN_PLACE_M = 0.15
"""A jump shorter than this does not count for the range of directions."""

NEAR_DUPLICATE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """A built verb, with warnings.

    Parameters
    ----------
    verb : Verb
    warnings : tuple of str
    worst_stored : str
        The example whose stored adverbs differ most from the measured ones, with both; empty if nothing is measured.
    """

    verb: Verb
    warnings: tuple[str, ...]
    worst_stored: str


def build(folder: str | Path, *, progress: Progress | None = None, inspect: bool = True) -> Built:
    """Build a verb from its source folder.

    Parameters
    ----------
    folder : str or Path
        With ``verb.toml`` and one motion file per example.
    progress : callable, optional
        Called with the name of a stage, the steps done and the number of steps.
    inspect : bool
        Whether to search the motions for faults and for another axis up; these are warnings only.

    Returns
    -------
    built : Built
        Adverbs in their declared unit, everything else in metres, seconds and radians.

    Raises
    ------
    SourceError
        The folder or its ``verb.toml`` is wrong; names the example and what to do.
    SkeletonMismatch
        Two motions have different skeletons.
    IllPosedVerb
        The examples do not determine a verb.

    Source: Rose, Sloan, Cohen 2001, section 3; Feng, Huang, Kallmann, Shapiro 2012, section 3.
    """
    report = progress or (lambda stage, done, total: None)
    source = read(folder)
    motions, digests, notes, tolerance_m = read_motions(source, report, inspect=inspect)
    fixed = mended(source, motions, tolerance_m=tolerance_m, inspect=inspect)
    source, motions = fixed.source, fixed.motions
    made = assemble(source, motions, progress=progress)
    verb, keytimes, source = made.verb, made.keytimes, made.source
    report("contacts", 0, 1)
    verb = replace(verb, contacts=contacts_of(source, verb, motions, keytimes))
    report("contacts", 1, 1)
    report("quality", 0, 1)
    quality = {"chart_reason": made.chart_reason, **_quality(verb, motions, keytimes)}
    report("quality", 1, 1)
    provenance = {
        "source": source.provenance,
        "files": {example.file.name: digest for example, digest in zip(source.examples, digests, strict=True)},
        "simplices": [list(row) for row in source.simplices],
        "built_by": f"adverb {metadata.version('adverb')}",
        **({"mends": fixed.rows} if fixed.rows else {}),
    }
    lines = (*source.warnings, *notes, *fixed.warnings, *made.warnings)
    return Built(replace(verb, quality=quality, provenance=provenance), lines, made.worst_stored)


@dataclass(frozen=True, slots=True, eq=False)
class Assembled:
    """A verb without contacts, quality and provenance, with what its build found.

    Parameters
    ----------
    verb : Verb
    source : Source
        With the keytimes that the build adds.
    keytimes : (N, M) float64
        Seconds from the start of each file.
    warnings : tuple of str
    worst_stored, chart_reason : str
    """

    verb: Verb
    source: Source
    keytimes: F64
    warnings: tuple[str, ...]
    worst_stored: str
    chart_reason: str


def assemble(source: Source, motions: list[Motion], *, progress: Progress | None = None) -> Assembled:
    """Fit curves to motions, measure the adverbs and solve the bases; errors as in :func:`build`.

    Parameters
    ----------
    source : Source
    motions : list of Motion
        Of the source's examples, in their order, with one skeleton.
    progress : callable, optional
    """
    report = progress or (lambda stage, done, total: None)
    keytimes = np.array([_checked_keytimes(source, e, m) for e, m in zip(source.examples, motions, strict=True)])
    source, keytimes = apex.mark(source, motions, keytimes)
    report("fitting curves", 0, 1)
    names = [example.name for example in source.examples]
    root_motion = poses.STRIDE if source.looping else poses.ABSOLUTE
    mode = poses.ROTATION_VECTOR if source.rotations == "rotation_vector" else poses.NLERP
    rate = max(curves.CURVE_RATE_HZ, min(120.0, max(motion.fps for motion in motions)))
    phases, intervals = curves.canonical_phases(keytimes, rate, count=source.samples)
    fitted = curves.fit(
        motions,
        names,
        keytimes,
        phases,
        intervals,
        looping=source.looping,
        climbing=source.climbing,
        root_motion=root_motion,
        rotation_mode=mode,
    )
    report("fitting curves", 1, 1)
    report("solving the basis", 0, 1)
    stored = np.array([example.values for example in source.examples])
    draft = centred(_draft(source, motions, keytimes, phases, fitted, stored, root_motion, mode))
    values, warnings, worst = _measured_values(draft, stored)
    fields, reason = _bases(source, draft, values)
    verb = replace(draft, values=values, adverbs=_ranges(draft.adverbs, draft.measure, values), **fields)
    report("solving the basis", 1, 1)
    return Assembled(verb, source, keytimes, (*fitted.warnings, *warnings), worst, reason)


def _checked_keytimes(source: Source, example: SourceExample, motion: Motion) -> F64:
    marks, end = np.array(example.keytimes), motion.duration_s
    for name, mark in zip(source.keytime_names, marks, strict=True):
        if mark < 0 or mark > end + KEYTIME_SLACK_S:
            raise SourceError(
                source.path,
                f"keytime '{name}' is {mark} s, but the motion lasts from 0 to {end:.5f} s",
                example=example.name,
            )
    marks = np.minimum(marks, end)
    short = int(np.argmin(np.diff(marks)))
    if marks[short + 1] - marks[short] < KEYTIME_SLACK_S:
        raise SourceError(
            source.path,
            f"keytimes '{source.keytime_names[short]}' and '{source.keytime_names[short + 1]}' are less than "
            f"{KEYTIME_SLACK_S * 1000:g} ms apart; move one",
            example=example.name,
        )
    if source.looping and (marks[0] > KEYTIME_SLACK_S or marks[-1] < end - KEYTIME_SLACK_S):
        raise SourceError(
            source.path,
            f"a looping verb's keytimes must span the whole file (0 to {end:.5f} s): one file is one cycle",
            example=example.name,
        )
    return np.asarray(marks, np.float64)


def _draft(
    source: Source,
    motions: list[Motion],
    keytimes: F64,
    phases: F64,
    fitted: curves.Curves,
    stored: F64,
    root_motion: int,
    mode: int,
) -> Verb:
    """The verb with the adverbs that its source states, before they are measured."""
    stances: tuple[Span, ...] = ()
    if needs_stances(source):
        plain = replace(source, adverbs=tuple(replace(a, measure=None) for a in source.adverbs), measure="none")
        bare = _draft(plain, motions, keytimes, phases, fitted, stored, root_motion, mode)
        stances = stances_of(contacts_of(source, bare, motions, keytimes))
    measure = measure_of(source, motions, keytimes, phases, stances)
    adverbs = tuple(Adverb(a.name, a.unit, a.description, a.style, 0.0, 0.0) for a in source.adverbs)
    examples = tuple(example.name for example in source.examples)
    chart = charts.plain(source, measure, stored)
    _check_duplicates(chart, stored, examples)
    _check_spread(chart, stored, tuple(a.name for a in adverbs))
    return Verb(
        name=source.name,
        description=source.description,
        looping=source.looping,
        skeleton=motions[0].skeleton,
        adverbs=_ranges(adverbs, measure, stored),
        examples=examples,
        values=stored,
        keytime_names=source.keytime_names,
        keytimes=keytimes - keytimes[:, :1],
        phases=phases,
        curves=fitted.curves,
        references=fitted.references,
        rotation_mode=mode,
        root_motion=root_motion,
        strides=fitted.strides,
        measure=measure,
        domain=basis.domain_of(chart, stored),
        bases={"rbf": basis.cardinal(chart, stored, names=examples)},
    )


def _check_duplicates(chart: Chart, values: F64, names: tuple[str, ...]) -> None:
    points = chart.points(values)
    for first in range(len(points)):
        for second in range(first + 1, len(points)):
            if np.linalg.norm(points[first] - points[second]) < NEAR_DUPLICATE:
                raise IllPosedVerb(
                    f"examples '{names[first]}' and '{names[second]}' have the same adverbs {values[first].tolist()}; "
                    "leave one out, or add an adverb that differs"
                )


def _check_spread(chart: Chart, values: F64, adverbs: tuple[str, ...]) -> None:
    """Refuse examples that do not span the adverb space, naming the adverbs that do not vary."""
    points = chart.points(values)
    centred = points - points.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=True)
    rank = int(np.sum(sizes > 1e-6 * max(sizes[0], 1e-12)))
    dims = len(adverbs)
    if rank >= dims:
        return
    constant = [name for name, column in zip(adverbs, centred.T, strict=True) if np.ptp(column) < 1e-9]
    if constant:
        raise IllPosedVerb(
            f"adverb '{constant[0]}' has the same value in all {len(values)} examples; vary it, or leave it out"
        )
    tied = [name for name, share in zip(adverbs, np.abs(directions[-1]), strict=True) if share > 0.1]
    shape = "one line" if rank == 1 else f"a plane of {rank} dimensions"
    raise IllPosedVerb(
        f"the {len(values)} examples lie on {shape} of the {dims}-dimensional adverb space "
        f"({' and '.join(tied)} change together); add examples off it (at least {dims + 1} in all), or drop an adverb"
    )


def _ranges(adverbs: tuple[Adverb, ...], measure: Measure, values: F64) -> tuple[Adverb, ...]:
    """Adverbs with their ranges over the examples; jumps in place do not count for the direction."""
    counted = values.copy()
    if measure.kind == measures.JUMP:
        distance, direction, _ = measure.axes
        counted[measure.frame[0, 0] * values[:, distance] < IN_PLACE_M, direction] = np.nan
    counted = np.where(np.isnan(counted).all(axis=0), 0.0, counted)
    lows, highs = np.nanmin(counted, axis=0), np.nanmax(counted, axis=0)
    return tuple(
        replace(adverb, minimum=float(low), maximum=float(high))
        for adverb, low, high in zip(adverbs, lows, highs, strict=True)
    )


def _measured_values(draft: Verb, stored: F64) -> tuple[F64, list[str], str]:
    """Adverbs as measured on the stored curves; warnings where the stored ones differ; the largest difference."""
    goal = Goal.of_verb(draft)
    if not goal.measurable:
        return stored, [], ""
    points = goal.measured(np.eye(len(stored)))
    values = stored.copy()
    values[:, draft.measure.axes], gaps = goal.compare(stored, points)
    lines = []
    for name, given, found, gap in zip(draft.examples, stored, values, gaps, strict=True):
        pairs = (_stored_and_measured(draft.adverbs[a], given[a], found[a]) for a in draft.measure.axes)
        lines.append(f"'{name}': {', '.join(pairs)}; {quantity(gap, draft.measure.unit)} apart")
    warnings = [
        f"stored adverbs differ from the measured ones, which are used, in example {line}"
        for line, gap in zip(lines, gaps, strict=True)
        if gap > ADVERB_TOLERANCE
    ]
    return values, warnings, lines[int(np.argmax(gaps))]


def _stored_and_measured(adverb: Adverb, given: float, found: float) -> str:
    """Both values of an adverb, in its own unit."""
    unit = "" if adverb.unit == "none" else adverb.unit
    return f"{adverb.name} {given:.4f} {unit}".rstrip() + f" (measured {found:.4f} {unit}".rstrip() + ")"


def _bases(source: Source, draft: Verb, values: F64) -> tuple[dict[str, Any], str]:
    """Domain and bases of the measured adverbs, as fields of a verb, and the reason for the domain's chart."""
    plain = charts.plain(source, draft.measure, values)
    _check_duplicates(plain, values, draft.examples)
    chart, reason = charts.choose(source, draft.measure, values, start=draft.curves[1, :, :3].mean(axis=0))
    bases = {"rbf": basis.cardinal(plain, values, names=draft.examples)}
    if draft.measure.kind != measures.NOTHING:
        bases["smooth"] = basis.smooth(chart, values, degree=TAILS.index(source.tail), names=draft.examples)
    return {"domain": basis.domain_of(chart, values), "bases": bases}, reason


def _quality(verb: Verb, motions: list[Motion], keytimes: F64) -> dict[str, Any]:
    """Quality stored in the artifact: error at the examples, of the curves, and inside the domain."""
    evaluator = Evaluator(verb)
    quality: dict[str, Any] = {
        "domain": describe(verb),
        "condition": verb.bases["rbf"].condition,
        "curve_error_max_m": _figure(_curve_error(evaluator, motions, keytimes)),
        "unit": verb.measure.unit,
    }
    if evaluator.goal.measurable:
        points = random_points(verb, np.random.default_rng(7), QUALITY_POINTS)
        quality |= {
            "error_examples_max_m": _figure(evaluator.blend(verb.values).error.max()),
            "samples": QUALITY_POINTS,
            "diagonal_m": _figure(diagonal(verb)),
            "method": default_method(verb),
            "methods": {name: _inside(evaluator, name, points) for name in ("rbf", default_method(verb))},
        }
    return quality


def _inside(evaluator: Evaluator, method: str, points: F64) -> dict[str, float]:
    """Error and sum of absolute weights of one method inside the domain."""
    blend = evaluator.blend(points, method=method)
    return {
        "error_mean_m": _figure(blend.error.mean()),
        "error_max_m": _figure(blend.error.max()),
        "weight_sum_max": _figure(np.abs(blend.weights).sum(axis=1).max()),
    }


def _figure(value: float) -> float:
    """A measured figure with the digits that mean something: nine, and none below 1e-11.

    The last digits depend on the order of sums, which differs between a kernel that was just compiled and the same
    kernel from the cache; a build gives the same bytes either way.
    """
    return float(f"{round(float(value), 11):.9g}")


def _curve_error(evaluator: Evaluator, motions: list[Motion], keytimes: F64) -> float:
    """Largest distance of any joint at any frame between the motions and the verb at the examples' weights, metres."""
    verb, worst = evaluator.verb, 0.0
    for i, (motion, marks) in enumerate(zip(motions, keytimes, strict=True)):
        frames = np.arange(len(motion))
        times = frames / motion.fps - marks[0]
        kept = (times >= -1e-9) & (times <= marks[-1] - marks[0] + 1e-9)
        unit = np.zeros((1, len(motions)))
        unit[0, i] = 1.0
        blend = evaluator.measure("example", unit, verb.values[i : i + 1], np.zeros(1, bool))
        shown = evaluator.pose_of(blend, time_s=np.clip(times[kept], 0.0, None), plant=False)
        _, found = evaluator.positions(shown)
        true_root, true_rotations = motion.root[kept], motion.rotations[kept]
        global_rotations, positions = np.empty_like(true_rotations), np.empty((len(true_root), len(verb.skeleton), 3))
        poses.forward(
            np.ascontiguousarray(true_root),
            np.ascontiguousarray(true_rotations),
            verb.skeleton.parents,
            verb.skeleton.offsets,
            global_rotations,
            positions,
        )
        if verb.looping:  # a loop starts at the origin; the file may start elsewhere
            positions = positions - np.array([motion.root[0, 0], 0.0, motion.root[0, 2]])
        worst = max(worst, float(np.linalg.norm(found - positions, axis=-1).max()))
    return worst
