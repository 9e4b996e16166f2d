from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs.sources import arm_source
from verbs.authoring.fit import build
from verbs.cli import app
from verbs.domain import inside
from verbs.errors import OutOfRange
from verbs.proposal.suggest import Expected, suggest
from verbs.quality.leave_one_out import left_out_errors

ANGLES = {f"a{i}{j}": (0.1 + 0.25 * i, 0.2 + 0.25 * j) for i in range(5) for j in range(5)}


@pytest.fixture(scope="module")
def holed(tmp_path_factory):
    """An arm whose examples leave out a corner of a regular grid of angles, and the angles left out."""
    left_out = [name for name in ANGLES if name[1] in "23" and name[2] in "23"]
    angles = {name: pair for name, pair in ANGLES.items() if name not in left_out}
    verb = build(arm_source(tmp_path_factory.mktemp("arm"), angles=angles)).verb
    return verb, [ANGLES[name] for name in left_out]


def test_the_first_suggestion_is_where_examples_are_missing(holed):
    verb, _ = holed
    best = suggest(verb, 1)[0]
    distance = np.linalg.norm(verb.values - best.adverbs, axis=1).min()
    spacing = [np.sort(np.linalg.norm(verb.values - one, axis=1))[1] for one in verb.values]
    assert distance > 1.1 * np.median(spacing)
    assert set(best.nearest) & {"a11", "a12", "a13", "a14", "a21", "a24", "a31", "a34", "a41", "a42", "a43"}


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


def test_the_expected_error_is_that_of_left_out_examples_where_roughness_is_even(holed):
    verb, _ = holed
    errors = left_out_errors(verb, ("corrected",))[0][0]
    model = Expected.of_verb(verb, errors)
    centers = verb.domain.chart.points(verb.values)
    assert np.abs(model.covariance(centers, centers)).max() < 1e-6  # no error at an example
    keep = np.arange(len(errors)) != 7
    gaps, point = model._kernel(centers[keep], centers[keep]), centers[7:8]
    system = np.block([[gaps, np.ones((len(gaps), 1))], [np.ones((1, len(gaps))), np.zeros((1, 1))]])
    row = np.append(model._kernel(point, centers[keep])[0], 1.0)
    variance = -row @ np.linalg.solve(system, row)
    assert errors[7] / np.sqrt(variance) == pytest.approx(model.roughness[7], rel=1e-4)


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
    folder = arm_source(tmp_path / "arm", angles={name: (a + 0.3, b + 0.3) for name, (a, b) in ANGLES.items()})
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
