"""``corrected`` is exact for every kind of measure that adverbs name, alone and together, measured from poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.verbs import walker
from tests.verbs.posed_measures import Posed
from tests.verbs.redeclared import positions, redeclare
from tests.verbs.swings import swing_source
from verbs.adverb_measure import FORMS
from verbs.authoring.fit import build
from verbs.domain import random_points
from verbs.kernels import measure as measures
from verbs.runtime.evaluate import Evaluator
from verbs.units import SI_UNITS
from verbs.verb import Verb

EXACT = 1e-9
"""SI: error of every measure that poses give without differences."""

DIFFERENCES = 1e-6
"""SI: error of velocities, which the oracle takes as differences of poses."""


def measured_by(kind: str, axis: str, when: str) -> dict:
    """The ``measure`` table of a kind, of the right hand or upper arm at or between keytimes."""
    table = {"kind": kind, "axis": axis}
    if FORMS[kind].joint or kind == "foot_speed":
        table["joint"] = "RightHand"
    if axis in ("azimuth", "elevation"):
        table |= {"joint": "RightArm", "toward": "RightForeArm"}
    return table | ({"at": "reach"} if when == "at" else {"between": ["reach", "back"]})


def adverb(name: str, kind: str, axis: str, when: str, **more) -> dict:
    """An ``[[adverb]]`` table in SI."""
    return {
        "name": name, "unit": SI_UNITS[FORMS[kind].axes[axis][1]], "measure": measured_by(kind, axis, when) | more,
    }  # fmt: skip


def cases() -> list[tuple[str, str, str]]:
    """Every kind, axis, and ``at`` or ``between``."""
    found = []
    for kind, form in FORMS.items():
        whens = ["at"] if kind == "time_to" else [when for when in ("at", "between") if getattr(form, when)]
        found += [(kind, axis, when) for axis in form.axes for when in whens]
    return found


@pytest.fixture(scope="module", params=[False, True], ids=["blended root", "striding root"])
def swings(request, tmp_path_factory) -> Path:
    return swing_source(tmp_path_factory.mktemp("swings") / "source", looping=request.param)


def check(verb: Verb, *, count: int = 60, posed: int = 6) -> None:
    """Goals inside the domain: exact by the verb's measure, and by the oracle for some of them."""
    assert verb.measure.kind == measures.ADVERBS
    evaluator, factors = Evaluator(verb), np.array([row.factor for row in verb.measure.rows])
    goals = np.concatenate([verb.values[: posed // 2], random_points(verb, np.random.default_rng(5), count)])
    blend = evaluator.blend(goals)
    assert blend.method == "corrected"
    assert not blend.clamped.any()
    errors = np.abs(blend.measured - goals[:, verb.measure.axes]) * factors
    assert errors.max() < EXACT
    for k in range(posed):
        one = Posed(evaluator, evaluator.blend(goals[k : k + 1]))
        for row, goal in zip(verb.measure.rows, goals[k, verb.measure.axes] * factors, strict=True):
            slopes = row.kind == "angular_velocity" or (row.kind in ("velocity", "speed") and row.spans[0].end is None)
            assert abs(one.value(row) - goal) < (DIFFERENCES if slopes else EXACT), (row.kind, row.axis)


@pytest.mark.parametrize(("kind", "axis", "when"), cases())
def test_each_kind_alone(swings, tmp_path, kind, axis, when):
    verb = build(redeclare(swings, tmp_path / "source", [adverb("one", kind, axis, when)])).verb
    assert np.ptp(verb.values) > 0.02
    check(verb)


TOGETHER = {
    "place, time and speed": [
        *positions("RightHand", "reach"),
        adverb("when", "time_to", "time", "at"),
        adverb("fast", "speed", "speed", "at"),
    ],
    "angles and travel": [
        adverb("yaw", "orientation", "yaw", "at", joint="Chest"),
        adverb("spin", "angular_velocity", "speed", "at"),
        adverb("ahead", "root_motion", "forward", "between"),
        adverb("lasts", "duration", "time", "between"),
    ],
    "velocities": [
        adverb("vx", "velocity", "x", "at"),
        adverb("vz", "velocity", "z", "between"),
        adverb("shift", "displacement", "distance", "between"),
        adverb("feet", "foot_speed", "forward", "between"),
    ],
}


@pytest.mark.parametrize("name", TOGETHER)
def test_several_kinds_in_one_verb(tmp_path, name):
    source = swing_source(tmp_path / "swings", count=24)
    check(build(redeclare(source, tmp_path / "source", TOGETHER[name])).verb)


def test_both_hands_in_one_verb(tmp_path):
    source = swing_source(tmp_path / "swings", count=40)
    adverbs = [*positions("LeftHand", "reach", prefix="l"), *positions("RightHand", "back", prefix="r")]
    verb = build(redeclare(source, tmp_path / "source", adverbs)).verb
    assert verb.measure.unit == "m"
    check(verb)


def test_other_units_and_a_style_adverb(tmp_path):
    source = swing_source(tmp_path / "swings", count=16)
    adverbs = [
        adverb("yaw", "orientation", "yaw", "at", joint="Chest") | {"unit": "deg"},
        {"name": "mood", "style": True},
        adverb("fast", "speed", "speed", "between") | {"unit": "km/h"},
    ]
    verb = build(redeclare(source, tmp_path / "source", adverbs)).verb
    assert verb.measure.axes.tolist() == [0, 2]
    check(verb)
    evaluator = Evaluator(verb)
    goals = random_points(verb, np.random.default_rng(1), 20)
    np.testing.assert_allclose(evaluator.blend(goals).weights @ verb.values[:, 1], goals[:, 1], atol=1e-9)


def test_the_speed_of_feet_in_the_stances_that_are_found(tmp_path):
    walks = {f"w{k}": walker.walk(0.7 + 0.2 * k, 1.3 - 0.1 * k) for k in range(4)}
    source = walker.source(tmp_path / "walk", walks, looping=True)
    verb = build(
        redeclare(source, tmp_path / "source", [{"name": "v", "unit": "m/s", "measure": {"kind": "foot_speed"}}])
    )
    assert len(verb.verb.measure.rows[0].spans) >= 2
    np.testing.assert_allclose(verb.verb.values[:, 0], [0.7, 0.9, 1.1, 1.3], rtol=0.02)
    check(verb.verb)


def test_a_captured_verb(mocap, tmp_path):
    adverbs = [
        *positions("RightHand", "contact"),
        {"name": "when", "unit": "s", "measure": {"kind": "time_to", "at": "contact"}},
        {"name": "fast", "unit": "m/s", "measure": {"kind": "speed", "joint": "RightHand", "at": "contact"}},
    ]
    check(build(redeclare(mocap / "punch", tmp_path / "source", adverbs)).verb)


def test_nearly_equal_adverbs_of_unlike_motions_are_met(tmp_path):
    """Two examples differ by half a millimetre a second: between them the smooth weights reach ±9."""
    source = swing_source(tmp_path / "swings")
    verb = build(redeclare(source, tmp_path / "source", [adverb("v", "velocity", "z", "at")])).verb
    assert np.diff(np.sort(verb.values[:, 0])).min() < 1e-3
    check(verb, count=400)
