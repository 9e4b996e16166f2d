"""Measures that adverbs name: values against poses, Jacobians against central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.verbs import sources, walker
from verbs.adverb_measure import FORMS, AdverbMeasure, Span
from verbs.authoring.fit import build
from verbs.conventions import MAX_ADVERBS
from verbs.goal import Goal
from verbs.kernels import measure as measures
from verbs.kernels import quat
from verbs.kernels.adverb_measures import measure_adverbs, scratch_of
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Measure, Verb

STEP = 1e-6


def declared(verb: Verb, rows: list[AdverbMeasure]) -> Verb:
    """The verb with these measures; adverbs keep their values, which do not matter here."""
    count = len(rows)
    axes = np.arange(count)
    adverbs = tuple(replace(verb.adverbs[0], name=f"a{k}") for k in range(count))
    values = np.random.default_rng(3).normal(size=(len(verb.examples), count))
    chart, facets = verb.domain.chart, np.concatenate([np.eye(count), -np.eye(count)])
    chart = replace(chart, kind=0, axes=np.zeros(3, np.int64), shift=np.zeros(count), scale=np.ones(count))
    domain = replace(verb.domain, chart=chart, facets=facets, middle=np.zeros(count))
    rbf = verb.bases["rbf"]
    basis = replace(
        rbf, chart=chart, degree=0, centers=values, radii=np.ones(len(values)), poly=np.zeros((1, len(values))),
        radial=np.eye(len(values)),
    )  # fmt: skip
    measure = Measure(measures.ADVERBS, 0, -1, axes, np.zeros(3), np.zeros((3, count)), tuple(rows))
    return replace(verb, adverbs=adverbs, values=values, measure=measure, domain=domain, bases={"rbf": basis})


def every(joints: list[int], phases: list[float]) -> list[AdverbMeasure]:
    """Every kind of measure with every axis."""
    rows, (begin, end) = [], phases
    unit = np.array([0.3, -0.2, 0.5, 0.7]) / np.linalg.norm([0.3, -0.2, 0.5, 0.7])
    for kind, form in FORMS.items():
        for axis in form.axes:
            base = (0.6, 0.0, 0.8, 0.0) if axis in ("azimuth", "elevation") else tuple(unit.tolist())
            spans = [Span(joint, begin) for joint in joints] if form.at else []
            spans += [Span(joint, begin, end) for joint in joints] if form.between else []
            rows += [AdverbMeasure(kind, axis, (span,), 1.0, 0.0, base) for span in spans]
    feet = tuple(Span(joint, begin, end) for joint in joints)
    return [*rows, AdverbMeasure("foot_speed", "forward", feet, 1.0, 0.0, tuple(unit.tolist()))]


@pytest.fixture(scope="module")
def verbs(tmp_path_factory) -> dict[str, Verb]:
    """Verbs with a blended root (both ways of blending rotations) and with a striding one, that turns and climbs."""
    folder = tmp_path_factory.mktemp("verbs")
    arm = sources.arm_source(folder / "arm")
    found = {"quaternions": build(arm).verb}
    text = (arm / "verb.toml").read_text()
    (arm / "verb.toml").write_text('rotations = "rotation_vector"\n' + text)
    found["vectors"] = build(arm).verb
    walks = {"slow": walker.walk(0.8, 1.2), "fast": walker.walk(1.4, 0.9), "mid": walker.walk(1.1, 1.0)}
    walk = build(walker.source(folder / "walk", walks, looping=True)).verb
    strides = walk.strides + 0.004 * np.random.default_rng(2).normal(size=walk.strides.shape)
    found["walk"] = replace(walk, strides=strides)
    return found


def jacobian(verb: Verb, weights):
    """Measures (m,) and Jacobian (m, N) of the kernel."""
    goal = Goal.of_verb(verb)
    out, found = np.empty(goal.width), np.empty((goal.width, len(weights)))
    measure_adverbs(weights, goal.own, scratch_of(goal.own), out, found)
    return out, found


def sample(count: int, seed: int):
    """Weights that sum to 1, some of them negative."""
    weights = np.random.default_rng(seed).normal(0.3, 0.5, count)
    return weights / weights.sum() if abs(weights.sum()) > 0.5 else np.full(count, 1.0 / count)


def knot(verb: Verb, share: float) -> float:
    return round(share * verb.intervals) / verb.intervals


@pytest.mark.parametrize("name", ["quaternions", "vectors", "walk"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_equals_central_differences(verbs, name, seed):
    verb = verbs[name]
    last = len(verb.skeleton) - 1
    phases = [knot(verb, 0.3), knot(verb, 0.8)] if seed < 3 else [knot(verb, 0.45), 1.0]
    rows = every([last, 1], phases)
    parts = [declared(verb, rows[first : first + MAX_ADVERBS]) for first in range(0, len(rows), MAX_ADVERBS)]
    assert max(_compare(part, sample(len(verb.examples), seed)) for part in parts) > 0.1


def _compare(changed: Verb, weights) -> float:
    """Compare the Jacobian with central differences; return its largest number."""
    goal = Goal.of_verb(changed)
    _, exact = jacobian(changed, weights)
    nudged = np.repeat(weights[None], len(weights), axis=0)
    ahead, behind = nudged + STEP * np.eye(len(weights)), nudged - STEP * np.eye(len(weights))
    differences = goal.measured(ahead) - goal.measured(behind)
    rough = (differences / (2 * STEP)).T
    for row, one, other in zip(changed.measure.rows, exact, rough, strict=True):
        if np.abs(other).max() > 1e4:  # at a pole: a direction straight up, a speed of 0
            continue
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5, err_msg=f"{row.kind} {row.axis} {row.spans}")
    return float(np.abs(exact).max())


@pytest.mark.parametrize("name", ["quaternions", "vectors", "walk"])
def test_values_are_those_of_poses(verbs, name):
    verb = verbs[name]
    last, (begin, end) = len(verb.skeleton) - 1, (knot(verb, 0.3), knot(verb, 0.8))
    rows = [AdverbMeasure("position", axis, (Span(last, begin),), 1.0) for axis in "xyz"]
    rows += [AdverbMeasure("velocity", axis, (Span(last, begin),), 1.0) for axis in "xyz"]
    rows += [AdverbMeasure("displacement", axis, (Span(last, begin, end),), 1.0) for axis in "xyz"]
    rows += [AdverbMeasure("angular_velocity", axis, (Span(last, begin),), 1.0) for axis in "xyz"]
    rows += [AdverbMeasure("velocity", axis, (Span(last, begin, end),), 1.0) for axis in "xyz"]
    changed = declared(verb, [*rows, AdverbMeasure("duration", "time", (Span(0, begin, end),), 1.0)])
    weights = sample(len(verb.examples), 5)
    found, _ = jacobian(changed, weights)
    evaluator = Evaluator(verb)
    blend = evaluator.measure("own", weights[None], verb.values[:1], np.zeros(1, bool))
    at = evaluator.pose_of(blend, phase=np.array([begin, end]), plant=False)
    _, places = evaluator.positions(at)
    nearby = evaluator.pose_of(blend, time_s=at.time_s[0] + np.array([-1e-4, 0.0, 1e-4]), plant=False)
    turned, moved = evaluator.positions(nearby)
    np.testing.assert_allclose(found[0:3], places[0, last], atol=1e-9)
    np.testing.assert_allclose(found[3:6], (moved[2, last] - moved[0, last]) / 2e-4, atol=2e-3)
    np.testing.assert_allclose(found[6:9], places[1, last] - places[0, last], atol=1e-9)
    spin = quat.log(quat.mul(turned[2, last], quat.conjugate(turned[0, last]))) / 2e-4
    np.testing.assert_allclose(found[9:12], spin, atol=2e-3)
    seconds = at.time_s[1] - at.time_s[0]
    np.testing.assert_allclose(found[12:15], found[6:9] / seconds, atol=1e-9)
    assert found[15] == pytest.approx(seconds, abs=1e-12)


def test_orientation_of_known_rotations():
    """Yaw, pitch and roll of a rotation composed from them, about +Y, -X and +Z in this order."""
    verb_angles = (0.7, -0.4, 0.3)
    turn = np.array([0.0, verb_angles[0], 0.0])
    tilt, bank = np.array([-verb_angles[1], 0.0, 0.0]), np.array([0.0, 0.0, verb_angles[2]])
    rotation = quat.mul(quat.mul(quat.exp(turn), quat.exp(tilt)), quat.exp(bank))
    ahead, right, up = (quat.rotate(rotation, np.array(v)) for v in ([0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]))
    assert np.arctan2(ahead[0], ahead[2]) == pytest.approx(verb_angles[0])
    assert np.arcsin(ahead[1]) == pytest.approx(verb_angles[1])
    assert np.arctan2(right[1], up[1]) == pytest.approx(verb_angles[2])
