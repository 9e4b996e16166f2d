"""One verb in two sets of units: the same motions, the same errors in SI, adverbs in the declared unit."""

import json
import re
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs.sources import ANGLES, arm_source, hand
from verbs import units
from verbs.authoring.fit import build
from verbs.authoring.source import read
from verbs.cli import app
from verbs.domain import random_points
from verbs.errors import SourceError
from verbs.io import artifact
from verbs.kernels import chart as charts
from verbs.quality.leave_one_out import leave_one_out
from verbs.quality.quality_map import over
from verbs.refine import Rules, refine
from verbs.runtime import describe
from verbs.runtime.evaluate import Evaluator

OTHER = {"m": "cm", "rad": "deg", "m/s": "km/h", "rad/s": "deg/s"}


def converted(folder, target, other=OTHER):
    """A copy of a source with the same motions and its adverbs in other units."""
    shutil.copytree(folder, target)
    path = target / "verb.toml"
    text = path.read_text()
    old = [row.get("unit", "") for row in tomllib.loads(text)["adverb"]]
    factors = [units.si(unit) / units.si(other.get(unit, unit)) for unit in old]

    def scaled(match):
        values = [value * factor for value, factor in zip(json.loads(match[1]), factors, strict=True)]
        return f"adverb_values = {values}"

    text = re.sub(r"adverb_values = (\[[^]]*\])", scaled, text)
    path.write_text(re.sub(r'\nunit = "([^"]*)"', lambda match: f'\nunit = "{other.get(match[1], match[1])}"', text))
    return target, np.array(factors)


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    """The arm in metres, the same in centimetres, and the factor between their adverbs."""
    folder = tmp_path_factory.mktemp("arms")
    metres = arm_source(folder / "m")
    centimetres, factors = converted(metres, folder / "cm")
    return build(metres).verb, build(centimetres).verb, factors


def check_same(one, other, factors, methods):
    """The same poses within 1e-9 and the same errors for converted adverbs, by each method."""
    np.testing.assert_allclose(other.values, one.values * factors, rtol=1e-12, atol=1e-9)
    adverbs = random_points(one, np.random.default_rng(4), 40, gauge=(0.0, 1.2))
    first, second = Evaluator(one), Evaluator(other)
    for method in methods:
        pose = first.pose(adverbs, phase=0.45, method=method)
        same = second.pose(adverbs * factors, phase=0.45, method=method)
        np.testing.assert_allclose(same.rotations, pose.rotations, atol=1e-9)
        np.testing.assert_allclose(same.root, pose.root, atol=1e-9)
        np.testing.assert_allclose(same.duration_s, pose.duration_s, atol=1e-9)
        np.testing.assert_allclose(same.blend.error, pose.blend.error, atol=1e-9)
        measured = pose.blend.measured * factors[one.measure.axes]
        np.testing.assert_allclose(same.blend.measured, measured, rtol=1e-9, atol=1e-7)
        np.testing.assert_array_equal(same.blend.clamped, pose.blend.clamped)


def test_adverbs_in_centimetres_give_the_poses_of_those_in_metres(arms):
    one, other, factors = arms
    check_same(one, other, factors, ("rbf", "search", "inverse", "barycentric", "corrected"))
    assert [adverb.unit for adverb in other.adverbs] == ["cm", "cm"]
    assert other.adverbs[0].maximum == pytest.approx(100 * one.adverbs[0].maximum)
    assert other.measure.unit == "m"


CAPTURED = ("jump", "locomotion", "punch")


@pytest.mark.parametrize("name", CAPTURED)
def test_captured_verbs_are_the_same_in_other_units(mocap, verb_of, name, tmp_path):
    """Degrees and km/h too, in every kind of chart."""
    folder, factors = converted(mocap / name, tmp_path / name)
    built = build(folder)
    check_same(verb_of(name), built.verb, factors, ("rbf", "search", "corrected"))
    artifact.save(built.verb, tmp_path / "other.verb")
    check_same(verb_of(name), artifact.load(tmp_path / "other.verb"), factors, ("corrected",))


def test_every_kind_of_chart_is_covered(verb_of):
    assert {verb_of(name).domain.chart.kind for name in CAPTURED} == set(charts.CHARTS.values())


def test_mixed_units_of_one_dimension_are_the_same_too(arms, tmp_path):
    text = (arm_source(tmp_path / "m") / "verb.toml").read_text().replace('"x"\nunit = "m"', '"x"\nunit = "mm"')
    text = re.sub(r"adverb_values = \[([^,]*),", lambda match: f"adverb_values = [{1000 * float(match[1])},", text)
    (tmp_path / "m" / "verb.toml").write_text(text)
    check_same(arms[0], build(tmp_path / "m").verb, np.array([1000.0, 1.0]), ("rbf", "corrected"))


def test_the_unit_of_the_files_is_not_that_of_the_adverbs(arms, tmp_path):
    """Motion files in centimetres, adverbs in metres."""
    folder = arm_source(tmp_path / "files")
    path = folder / "verb.toml"
    path.write_text('units = {length = "cm"}\n' + path.read_text())
    for file in folder.glob("*.bvh"):
        lines = file.read_text().splitlines()
        for k, line in enumerate(lines):
            if line.split()[0] == "OFFSET":
                lines[k] = "OFFSET " + " ".join(str(100 * float(number)) for number in line.split()[1:])
        file.write_text("\n".join(lines) + "\n")
    verb = build(folder).verb
    np.testing.assert_allclose(verb.values, arms[0].values, atol=1e-6)
    assert [adverb.unit for adverb in verb.adverbs] == ["m", "m"]


def test_quality_is_the_same_in_other_units(arms):
    one, other, _ = arms
    first, second = (leave_one_out(verb, ("rbf", "corrected")) for verb in (one, other))
    for row, same in zip(first, second, strict=True):
        assert same.error_mean == pytest.approx(row.error_mean, abs=1e-9)
        assert same.angle_mean_rad == pytest.approx(row.angle_mean_rad, abs=1e-9)
    maps = [over(Evaluator(verb), method="rbf", nodes=9) for verb in (one, other)]
    np.testing.assert_allclose(maps[1].columns, 100 * maps[0].columns)
    np.testing.assert_allclose(maps[1].error, maps[0].error, atol=1e-9)


def test_refinement_is_the_same_in_other_units(arms):
    first, second = (list(refine(verb, Rules(max_pseudo=4))) for verb in arms[:2])
    assert [step.pseudo for step in second] == [step.pseudo for step in first]
    assert second[-1].after.largest == pytest.approx(first[-1].after.largest, abs=1e-9)


def test_the_points_of_examples_stay_in_metres(arms):
    first, second = (describe.describe(verb) for verb in arms[:2])
    points = [[row["point"] for row in one["examples"]] for one in (first, second)]
    np.testing.assert_allclose(points[1], points[0], atol=1e-9)
    assert second["adverbs"][0]["unit"] == "cm"
    goal = np.array(second["measure"]["origin"]) + np.array(second["measure"]["frame"]) @ arms[1].values[0]
    np.testing.assert_allclose(goal, points[0][0], atol=1e-9)


def test_the_command_line_takes_and_gives_the_declared_unit(arms, tmp_path):
    artifact.save(arms[1], tmp_path / "arm.verb")
    x, y = arms[1].values.mean(axis=0).tolist()
    found = CliRunner().invoke(app, ["pose", str(tmp_path / "arm.verb"), "--at", f"x={x},y={y}", "--json"])
    record = json.loads(found.stdout)
    assert record["measured"]["x"] == pytest.approx(x, abs=1e-6)
    assert record["error"] < 1e-9
    assert not record["clamped"]


def test_stored_values_are_compared_in_the_declared_unit(tmp_path):
    folder, _ = converted(arm_source(tmp_path / "m"), tmp_path / "cm")
    x = hand(*ANGLES["a"])[0]
    text = (folder / "verb.toml").read_text()
    (folder / "verb.toml").write_text(
        re.sub(r"adverb_values = \[[^,]*", f"adverb_values = [{100 * x + 2}", text, count=1)
    )
    built = build(folder)
    assert f"'a': x {100 * x + 2:.4f} cm (measured {100 * x:.4f} cm)" in built.warnings[0]
    assert "20 mm apart" in built.warnings[0]


def test_a_jump_in_degrees_needs_readers_of_format_2(mocap, verb_of, tmp_path):
    folder, _ = converted(mocap / "jump", tmp_path / "jump", {"rad": "deg"})
    versions = []
    for verb in (verb_of("jump"), build(folder).verb):
        artifact.save(verb, tmp_path / "jump.verb")
        block = (tmp_path / "jump.verb").read_bytes()
        header = json.loads(block[8 : 8 + int.from_bytes(block[:8], "little")])
        versions.append(json.loads(header["__metadata__"]["adverb"])["format"])
    assert versions == [1, 2]


def test_a_label_of_an_older_artifact_changes_no_number(arms):
    """Before units were kept, values were in metres whatever the label."""
    one = arms[0]
    old = replace(one, adverbs=tuple(replace(adverb, unit="furlong") for adverb in one.adverbs))
    found = Evaluator(old).pose(one.values, phase=0.5)
    np.testing.assert_array_equal(found.rotations, Evaluator(one).pose(one.values, phase=0.5).rotations)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("furlong", "adverb 'x' has the unknown unit 'furlong'; known: m, cm, mm, rad, deg, m/s, km/h, .*, s, none"),
        ("deg", "takes adverb 'x' as a length, but its unit is 'deg'; use m or cm or mm"),
    ],
)
def test_a_unit_that_cannot_be_is_refused(tmp_path, unit, message):
    path = arm_source(tmp_path) / "verb.toml"
    path.write_text(path.read_text().replace('unit = "m"', f'unit = "{unit}"', 1))
    with pytest.raises(SourceError, match=message):
        build(tmp_path)


def test_every_named_unit_is_read(tmp_path):
    path = arm_source(tmp_path) / "verb.toml"
    text = path.read_text()
    for unit in ("m", "cm", "mm", "rad", "deg", "m/s", "km/h", "rad/s", "deg/s", "s", "none", ""):
        path.write_text(text.replace('unit = "m"', f'unit = "{unit}"\nstyle = true', 1))
        assert read(tmp_path).adverbs[0].unit == unit


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0123, "m", "12.3 mm"),
        (1.234, "m", "1.23 m"),
        (-0.5, "m", "-500 mm"),
        (0.02, "m/s", "20 mm/s"),
        (2.0, "m/s", "2 m/s"),
        (np.pi / 6, "rad", "30 deg"),
        (float("nan"), "m", "–"),
        (0.25, "", "0.25"),
    ],
)
def test_quantities_for_people_have_a_sensible_prefix(value, unit, text):
    assert units.quantity(value, unit) == text
