from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs.sources import arm_source, hand
from verbs.authoring.fit import build
from verbs.cli import app
from verbs.domain import inside
from verbs.errors import OutOfRange
from verbs.proposal.suggest import Kriging, suggest
from verbs.runtime.support import Support

ANGLES = {f"a{i}{j}": (0.1 + 0.25 * i, 0.2 + 0.25 * j) for i in range(5) for j in range(5)}


@pytest.fixture(scope="module")
def holed(tmp_path_factory):
    """An arm whose examples leave out a corner of a regular grid of angles, and the angles left out."""
    left_out = [name for name in ANGLES if name[1] in "23" and name[2] in "23"]
    angles = {name: pair for name, pair in ANGLES.items() if name not in left_out}
    verb = build(arm_source(tmp_path_factory.mktemp("arm"), angles=angles)).verb
    return verb, [ANGLES[name] for name in left_out]


def test_suggestions_are_apart_from_examples_and_fill_the_hole(holed):
    verb, angles = holed
    best = suggest(verb, 1)[0]
    distance = np.linalg.norm(verb.values - best.adverbs, axis=1).min()
    spacing = [np.sort(np.linalg.norm(verb.values - one, axis=1))[1] for one in verb.values]
    assert distance > 0.4 * np.median(spacing)
    hole = np.array([hand(*pair) for pair in angles])
    found = np.array([one.adverbs for one in suggest(verb, 6)])
    gaps = np.linalg.norm(found[:, None] - hole[None], axis=-1).min(axis=1)
    assert gaps.min() < 0.06  # one of the six is in the hole


def test_suggestions_keep_apart_and_gains_fall(holed):
    verb, _ = holed
    found = suggest(verb, 5)
    gains = [one.gain for one in found]
    assert gains == sorted(gains, reverse=True)
    assert 0.0 < sum(gains) < 1.0
    points = verb.domain.chart.points(np.array([one.adverbs for one in found]))
    assert inside(verb.domain, points).all()
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(5) * 9.0
    assert gaps.min() > 0.05
    for one in found:
        assert 0.0 < one.support < 1.0
        assert one.weight_sum >= 1.0 - 1e-9
        assert np.isfinite(one.positions).all()


def test_the_drop_is_that_of_kriging_with_the_example_made(holed):
    verb, _ = holed
    arrays = Support.of_verb(verb).arrays
    model = Kriging.of_points(np.array(arrays.centers), float(arrays.radius))
    places = verb.domain.chart.points(np.array([one.adverbs for one in suggest(verb, 4)]))
    drops = model.drop(places[1:], places[:1])[:, 0]
    after = Kriging.of_points(np.concatenate([model.centers, places[:1]]), model.radius)
    assert drops == pytest.approx(1.0 - np.sqrt(after.variance(places[1:]) / model.variance(places[1:])), abs=1e-6)


def test_the_variance_is_zero_at_an_example_and_that_of_support_elsewhere(holed):
    verb, _ = holed
    arrays = Support.of_verb(verb).arrays
    model = Kriging.of_points(np.array(arrays.centers), float(arrays.radius))
    assert model.variance(model.centers).max() < 1e-6
    one = Kriging.of_points(np.delete(model.centers, 3, axis=0), model.radius)
    assert one.variance(model.centers[3:4])[0] == pytest.approx(1.0 / model.inverse[3, 3], rel=1e-4)


def test_a_number_out_of_range_is_refused(holed):
    with pytest.raises(OutOfRange, match="1 to 50"):
        suggest(holed[0], 0)


def test_the_command_prints_reasons_and_draws_poses(tmp_path):
    folder = arm_source(tmp_path / "arm", angles=dict(list(ANGLES.items())[::2]))
    picture = tmp_path / "next.png"
    result = CliRunner().invoke(app, ["suggest", str(folder), "-n", "3", "--json", "-o", str(picture)])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert len(found) == 3
    assert set(found[0]["adverbs"]) == {"x", "y"}
    hand = np.array(found[0]["positions"]["Hand"])
    assert hand[:2] == pytest.approx(list(found[0]["adverbs"].values()), abs=0.01)
    assert picture.read_bytes()[:4] == b"\x89PNG"
    shown = CliRunner().invoke(app, ["suggest", str(folder), "-n", "2"])
    assert "expected" in shown.stdout
    assert "gain" in shown.stdout


def test_init_prints_a_table_and_json(tmp_path):
    folder = arm_source(tmp_path / "arm", angles=ANGLES)
    refused = CliRunner().invoke(app, ["init", str(folder)])
    assert refused.exit_code == 1
    assert "--force" in str(refused.exception)
    result = CliRunner().invoke(app, ["init", str(folder), "--effector", "Hand", "--force", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["builds"]
    assert [adverb["name"] for adverb in found["adverbs"]] == ["x", "y"]  # the arm moves in a plane
    assert len(found["clips"]) == len(ANGLES)
    build(folder)
    again = CliRunner().invoke(
        app, ["init", str(folder), "--effector", "Hand", "--annotated", "a00@0,0.5,1", "--force"]
    )
    assert again.exit_code == 0, again.output
    assert "from 1 annotated clip" in again.stdout
    wrong = CliRunner().invoke(app, ["init", str(folder), "--annotated", "a00", "--force"])
    assert wrong.exit_code == 1
    assert "FILE@" in str(wrong.exception)
