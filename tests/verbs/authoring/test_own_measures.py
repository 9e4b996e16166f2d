"""Adverbs that name measures of their own: from ``verb.toml`` to a verb, its file and its description."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verbs.redeclared import positions, redeclare
from tests.verbs.sources import arm_source
from verbs.adverb_measure import FORMS, Span
from verbs.authoring.fit import build
from verbs.authoring.mirrored_source import mirror_source
from verbs.authoring.source import parse, read
from verbs.domain import random_points
from verbs.errors import ArtifactCorrupt, IllPosedVerb, RequestError, SourceError, VerbError
from verbs.io import artifact
from verbs.kernels import measure as measures
from verbs.quality.leave_one_out import leave_one_out
from verbs.refine import Rules, refine
from verbs.runtime import describe
from verbs.runtime.characters import Characters
from verbs.runtime.evaluate import Evaluator

WHEN = {"name": "when", "unit": "s", "measure": {"kind": "time_to", "at": "reach"}}


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    return arm_source(tmp_path_factory.mktemp("arm") / "source")


@pytest.fixture(scope="module")
def timed(arm, tmp_path_factory):
    """Reaches by hand position (cm) and by the time of the reach."""
    adverbs = [*positions("Hand", "reach", unit="cm")[:2], WHEN]
    return build(redeclare(arm, tmp_path_factory.mktemp("timed") / "source", adverbs)).verb


def test_measured_values_are_those_of_the_verb_measure(arm, timed):
    plain = build(arm).verb
    assert timed.measure.kind == measures.ADVERBS
    np.testing.assert_allclose(timed.values[:, :2], 100.0 * plain.values, atol=1e-9)
    np.testing.assert_allclose(timed.values[:, 2], plain.keytimes[:, 1], atol=1e-12)
    assert timed.measure.unit == "SI"


def test_corrected_is_exact_in_all_of_them(timed):
    evaluator = Evaluator(timed)
    goals = random_points(timed, np.random.default_rng(1), 300)
    blend = evaluator.blend(goals)
    assert blend.method == "corrected"
    assert blend.error.max() < 1e-6
    np.testing.assert_allclose(blend.measured, goals, atol=1e-4)
    assert evaluator.blend(timed.values).error.max() < 1e-9
    reached = evaluator.pose_of(blend, phase=float(timed.phases[1]), plant=False)
    np.testing.assert_allclose(100.0 * evaluator.positions(reached)[1][:, 2, :2], goals[:, :2], atol=1e-4)
    np.testing.assert_allclose(reached.time_s, goals[:, 2], atol=1e-6)


def test_three_coordinates_alone_are_a_joint_position(mocap, tmp_path):
    named, plain = build(redeclare(mocap / "reach", tmp_path / "named", positions("RightHand", "apex"))).verb, None
    plain = build(mocap / "reach").verb
    assert named.measure.kind == measures.POSITION
    np.testing.assert_allclose(named.values, plain.values, atol=1e-12)
    assert named.measure.effector == plain.measure.effector
    assert named.measure.keytime == plain.measure.keytime
    goals = random_points(plain, np.random.default_rng(0), 50)
    np.testing.assert_array_equal(Evaluator(named).blend(goals).weights, Evaluator(plain).blend(goals).weights)


def test_the_general_form_gives_the_weights_of_a_joint_position(mocap):
    """The same goals by both paths: one kernel for positions, one for all measures."""
    from verbs.adverb_measure import AdverbMeasure
    from verbs.verb import Measure

    plain = build(mocap / "reach").verb
    at = (Span(plain.measure.effector, float(plain.phases[plain.measure.keytime])),)
    rows = tuple(AdverbMeasure("position", axis, at, 1.0) for axis in "xyz")
    zero = np.zeros((3, 3))
    own = replace(plain, measure=Measure(measures.ADVERBS, 0, -1, plain.measure.axes, zero[0], zero, rows))
    goals = random_points(plain, np.random.default_rng(0), 100)
    one, other = Evaluator(plain).blend(goals), Evaluator(own).blend(goals)
    np.testing.assert_allclose(one.measured, other.measured, atol=1e-9)
    np.testing.assert_allclose(one.weights, other.weights, atol=1e-7)
    np.testing.assert_allclose(Evaluator(own).goal.measured(one.weights), one.measured, atol=1e-12)


def test_a_file_keeps_the_measures(timed, tmp_path):
    artifact.save(timed, tmp_path / "a.verb")
    loaded = artifact.load(tmp_path / "a.verb")
    assert loaded.measure.rows == timed.measure.rows
    assert loaded.measure.axes.tolist() == [0, 1, 2]
    artifact.save(loaded, tmp_path / "b.verb")
    assert (tmp_path / "a.verb").read_bytes() == (tmp_path / "b.verb").read_bytes()


def test_a_reader_without_them_finds_a_verb_that_poses(timed, tmp_path, monkeypatch):
    """Readers ignore unknown facts: without ``measured`` the verb has no measure, and poses by rbf."""
    artifact.save(timed, tmp_path / "a.verb")
    arrays, facts = artifact._map(tmp_path / "a.verb")
    assert facts["format"] == 1
    assert facts["measure"]["kind"] == 0
    del facts["measured"]
    old = artifact._verb(arrays, facts)
    poses = Evaluator(old).pose(old.values[:1], phase=0.5)
    assert poses.blend.method == "rbf"
    assert np.isfinite(poses.rotations).all()


FIELDS = ["adverb", "kind", "axis", "spans", "factor", "center", "base"]
HOSTILE = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=4), st.just([]), st.just({}),
    st.just([[0, 0.5, 0.25]]), st.just([[99, 0.5]]), st.just([[0, 0.123456]]), st.just([[0, 0.5]] * 100),
    st.just([1.0, 1.0, 1.0, 1.0]), st.lists(st.floats(), min_size=4, max_size=4), st.sampled_from(list(FORMS)),
)  # fmt: skip


@given(st.integers(0, 2), st.sampled_from(FIELDS), HOSTILE)
def test_hostile_fields_are_refused_or_harmless(timed, row, field, value):
    facts = artifact._facts(timed)
    arrays = artifact._arrays(timed)
    facts = json.loads(json.dumps(facts))
    facts["measured"][row][field] = value
    try:
        verb = artifact._verb(arrays, facts)
    except (VerbError, KeyError, TypeError, ValueError, IndexError):
        return  # load() turns these into ArtifactCorrupt
    assert np.isfinite(Evaluator(verb).goal.measured(np.full((1, 5), 0.2))).all()


@pytest.mark.parametrize("rows", [0, "x", {}, [0], [{}]])
def test_a_file_with_another_list_is_corrupt(timed, tmp_path, rows, monkeypatch):
    own = artifact._facts
    monkeypatch.setattr(artifact, "_facts", lambda verb: own(verb) | {"measured": rows})
    artifact.save(timed, tmp_path / "a.verb")
    with pytest.raises(ArtifactCorrupt):
        artifact.load(tmp_path / "a.verb")


MEASURE = {"kind": "position", "joint": "Hand", "axis": "x", "at": "reach"}
ERRORS = [
    ({"kind": "place"}, "must be one of position, velocity"),
    ({"axis": "w"}, "must be one of x, y, z"),
    ({"axis": None}, "must be one of x, y, z"),
    ({"joint": None}, "needs a joint"),
    ({"joint": 3}, "give the name of a joint"),
    ({"at": "apex"}, "the keytimes are start, reach, end"),
    ({"at": None}, "needs at = one of start, reach, end"),
    ({"at": None, "between": ["start", "end"]}, "write at"),
    ({"between": ["start", "end"]}, "both 'at' and 'between'"),
    ({"jiont": "Hand"}, "did you mean 'joint'"),
    ({"toward": "Hand"}, "only an orientation"),
    ({"kind": "displacement", "at": None, "between": ["end", "start"]}, "must come before"),
    ({"kind": "displacement", "at": None, "between": "start"}, "must be two names"),
    ({"kind": "displacement"}, "between two keytimes"),
    ({"kind": "time_to", "axis": None, "joint": None, "at": "start", "unit": "s"}, "always 0"),
    ({"kind": "time_to", "axis": None, "unit": "s"}, "has no joint"),
    ({"kind": "time_to", "axis": None, "joint": None, "at": "reach"}, "is a time, but its unit is 'm'; use s"),
    ({"kind": "foot_speed", "axis": None, "at": None}, "its unit is 'm'; use m/s or km/h"),
]


def _table(change: dict, **more) -> dict:
    """A ``verb.toml`` of one adverb; ``change`` is of its measure, except the unit of the adverb."""
    measure = {key: value for key, value in (MEASURE | change).items() if value is not None}
    adverb = {"name": "x", "unit": measure.pop("unit", "m"), "measure": measure}
    example = [{"file": f"{k}.bvh", "keytimes": [0.0, 1.0, 2.0], "adverb_values": [float(k)]} for k in range(3)]
    head = {"name": "arm", "keytime_names": ["start", "reach", "end"], "adverb": [adverb], "example": example}
    return head | more


@pytest.mark.parametrize(("change", "text"), ERRORS)
def test_errors_name_the_adverb_and_what_to_do(change, text):
    with pytest.raises(SourceError, match="adverb 'x'") as caught:
        parse(Path("verb.toml"), _table(change))
    assert text in str(caught.value)


def test_the_example_of_the_documentation_is_read():
    text = (Path(__file__).parents[3] / "docs" / "source.md").read_text(encoding="utf-8")
    (block,) = [part for part in text.split("```") if "timed_punch" in part]
    table = tomllib.loads(block.removeprefix("toml"))
    table["example"].append(table["example"][0] | {"file": "high.bvh"})
    adverbs = parse(Path("verb.toml"), table).adverbs
    assert [one.measure and one.measure.kind for one in adverbs] == ["position", "time_to", "speed", None]


@pytest.mark.parametrize("key", ["measure", "effector_keytime_index", "goal"])
def test_measures_of_the_verb_and_of_adverbs_do_not_mix(key):
    value = {"measure": "joint_position", "effector_keytime_index": 1, "goal": {"origin": [0, 0, 0]}}[key]
    with pytest.raises(SourceError, match=f"'{key}' measures all adverbs together, but adverb 'x'"):
        parse(Path("verb.toml"), _table({}, **{key: value}))


def test_an_adverb_without_a_measure_beside_others_is_an_error():
    table = _table({})
    table["adverb"].append({"name": "mood", "unit": "none"})
    for row in table["example"]:
        row["adverb_values"].append(0.0)
    with pytest.raises(SourceError, match="adverb 'mood' has no measure, but others have"):
        parse(Path("verb.toml"), table)
    table["adverb"][1]["style"] = True
    assert parse(Path("verb.toml"), table).adverbs[1].measure is None
    table["adverb"][0]["style"] = True
    with pytest.raises(SourceError, match="style = true and a measure"):
        parse(Path("verb.toml"), table)


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=5), st.lists(st.text(max_size=5)),
    st.sampled_from([*FORMS, "x", "reach", "start", "Hand", "yaw", ["start", "end"], ["end", "reach"], {}]),
)  # fmt: skip
KEYS = st.sampled_from(["kind", "joint", "axis", "at", "between", "toward", "when"])


@given(st.one_of(VALUES, st.dictionaries(KEYS, VALUES, max_size=6)), st.sampled_from(["m", "deg", "s", "m/s", ""]))
def test_any_measure_is_read_or_refused(measure, unit):
    table = _table({})
    table["adverb"][0] |= {"measure": measure, "unit": unit}
    problem, found = "'x'", None
    try:
        found = parse(Path("verb.toml"), table).adverbs[0].measure
    except SourceError as err:
        problem = str(err)
    else:
        assert (found is None) == (measure is None)
    assert found is None or found.kind in FORMS
    assert "'x'" in problem


@pytest.mark.parametrize(
    ("measure", "text"),
    [
        (MEASURE | {"joint": "Tail"}, "adverb 'x'.*no joint 'Tail'|Tail"),
        ({"kind": "orientation", "joint": "Upper", "axis": "azimuth", "toward": "Hand", "at": "reach"}, "no child"),
        ({"kind": "orientation", "joint": "Hand", "axis": "azimuth", "at": "reach"}, "has no bone"),
        ({"kind": "foot_speed"}, "no foot stands"),
    ],
)
def test_joints_and_feet_that_are_missing(arm, tmp_path, measure, text):
    unit = {"position": "m", "orientation": "deg", "foot_speed": "m/s"}[measure["kind"]]
    with pytest.raises(SourceError, match=text):
        build(redeclare(arm, tmp_path / "s", [{"name": "x", "unit": unit, "measure": measure}]))


def test_the_description_names_each_measure(timed):
    rows = describe.describe(timed)
    assert rows["measure"]["kind"] == "adverbs"
    assert rows["measure"]["adverbs"] == ["x", "y", "when"]
    x, _, when = (row["measure"] for row in rows["adverbs"])
    assert (x["kind"], x["axis"], x["joint"], x["at"], x["unit"]) == ("position", "x", "Hand", "reach", "m")
    assert (when["kind"], when["joint"], when["at"], when["between"]) == ("time_to", None, "reach", None)
    assert describe.own_measure_text(timed, 0) == "position x of Hand at reach"
    assert describe.own_measure_text(timed, 2) == "time_to at reach"
    record = describe.pose_record(Evaluator(timed), Evaluator(timed).pose(timed.values[:1], phase=0.5), 0)
    assert list(record["measured"]) == ["x", "y", "when"]
    assert "measure" in json.loads(json.dumps(rows))["adverbs"][0]


def test_other_methods_refinement_and_left_out_examples(timed):
    evaluator = Evaluator(timed)
    goals = random_points(timed, np.random.default_rng(2), 20)
    plain = evaluator.blend(goals, method="rbf").error.mean()
    for method in ("search", "hybrid", "knn", "barycentric", "perdof"):
        assert np.isfinite(evaluator.blend(goals, method=method).error).all()
    assert evaluator.blend(goals, method="search").error.mean() < plain
    with pytest.raises(RequestError, match="inverse"):
        evaluator.blend(goals, method="inverse")
    *_, last = refine(timed, Rules(max_pseudo=4, samples=200))
    assert last.after.largest < 1.0
    assert evaluator.follow_window() is None


def test_a_verb_with_many_examples_leaves_them_out(mocap, tmp_path):
    when = {"name": "when", "unit": "s", "measure": {"kind": "time_to", "at": "contact"}}
    verb = build(redeclare(mocap / "punch", tmp_path / "p", [*positions("RightHand", "contact"), when])).verb
    (row,) = leave_one_out(verb, ("corrected",))
    assert 0.0 < row.angle_mean_rad < 1.0
    assert np.isfinite(row.error_mean)


def test_a_batch_has_the_weights_of_single_goals(timed):
    evaluator = Evaluator(timed)
    goals = random_points(timed, np.random.default_rng(4), 40)
    single = np.concatenate([evaluator.blend(goals[k : k + 1]).weights for k in range(len(goals))])
    np.testing.assert_allclose(evaluator.blend(goals).weights, single, atol=1e-9)
    points = timed.domain.chart.points(goals)
    np.testing.assert_allclose(evaluator.blend_points(points).weights, single, atol=1e-9)


def test_characters_meet_goals_that_change(timed):
    crowd = Characters(Evaluator(timed))
    goals = random_points(timed, np.random.default_rng(4), 24)
    slots = np.array([crowd.add(goal, phase=0.5, playing=False, half_life_s=0.0) for goal in goals])
    for wanted in (goals, goals[::-1]):
        crowd.aim_many(slots, np.ascontiguousarray(wanted))
        frames = crowd.step(slots, 1 / 60)
        assert frames.blend.error.max() < 1e-9
        np.testing.assert_allclose(frames.blend.measured, wanted, atol=1e-7)
        single = crowd.evaluator.pose(wanted, phase=0.5)
        np.testing.assert_allclose(frames.blend.weights, single.blend.weights, atol=1e-6)


def test_mirrored_measures(arm, tmp_path):
    adverbs = [
        *positions("Hand", "reach")[:2],
        {
            "name": "yaw",
            "unit": "deg",
            "measure": {"kind": "orientation", "joint": "Lower", "axis": "roll", "at": "reach"},
        },
    ]
    mirror_source(redeclare(arm, tmp_path / "a", adverbs), tmp_path / "b")
    mine, other = build(tmp_path / "a").verb, build(tmp_path / "b").verb
    np.testing.assert_allclose(other.values, mine.values * [-1, 1, -1], atol=1e-6)
    given = tomllib.loads((tmp_path / "b" / "verb.toml").read_text())
    assert given["adverb"][0]["measure"]["kind"] == "position"
    assert read(tmp_path / "b").measure == "adverbs"


def test_impossible_measures_are_refused_in_a_verb(timed):
    row = timed.measure.rows[0]
    changes: list[dict] = [
        {"factor": 0.0}, {"factor": np.nan}, {"center": np.inf}, {"base": (0.0, 0.0, 0.0, 2.0)}, {"axis": "yaw"},
        {"spans": ()}, {"spans": (Span(7, 0.5),)}, {"spans": (Span(0, -0.5),)}, {"spans": (Span(0, 0.0, 0.5),)},
        {"kind": "nothing"}, {"kind": "duration", "axis": "time"},
    ]  # fmt: skip
    for change in changes:
        rows = (replace(row, **change), *timed.measure.rows[1:])
        with pytest.raises(IllPosedVerb):
            replace(timed, measure=replace(timed.measure, rows=rows))
