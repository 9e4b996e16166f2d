import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import walker
from verbs import library
from verbs.authoring.fit import build
from verbs.cli import app
from verbs.quality import foot_contact
from verbs.quality.report import quality_of
from verbs.runtime.evaluate import Evaluator


def test_slide_is_the_largest_distance_from_the_mean_place_over_the_ground():
    path = np.zeros((11, 3))
    path[:, 0] = np.linspace(0.0, 0.1, 11)
    path[:, 1] = np.linspace(0.0, 0.9, 11)  # height is no slide
    found = foot_contact._distances(np.linspace(0, 1, 11), path, np.ones(11, bool), looping=False)
    np.testing.assert_allclose(found, [0.05])
    slides = foot_contact.Slides.of(np.array([0.05]), 0.01)
    assert (slides.stances, slides.median_m, slides.max_m, slides.penetration_m) == (1, 0.05, 0.05, 0.01)


def test_without_a_stance_there_is_no_slide():
    none = foot_contact.Slides.of(np.zeros(0), 0.01)
    assert none.stances == 0
    assert np.isnan(none.max_m)
    assert none.penetration_m == 0.01


def test_a_loop_counts_each_stance_once_also_one_across_its_seam():
    phases = np.arange(180) / 60.0
    standing = (phases % 1.0 > 0.8) | (phases % 1.0 < 0.2)
    path = np.zeros((180, 3))
    path[:, 2] = 0.1 * phases
    found = foot_contact._distances(phases, path, standing, looping=True)
    assert found == pytest.approx([0.02], abs=0.002)
    always = foot_contact._distances(phases, path, np.ones_like(standing), looping=True)
    assert always == pytest.approx([0.05], abs=0.002), "one cycle of a foot that stands all the time"


def evaluator_of(folder, motions, **keywords):
    return Evaluator(build(walker.source(folder / "figure", motions, **keywords)).verb)


def test_feet_that_slide_and_sink_by_known_lengths_are_measured(tmp_path):
    motions = {"still": walker.stand(), "slides": walker.stand(slide_m_s=0.1)}
    evaluator = evaluator_of(tmp_path, motions)
    still, slides = foot_contact.by_example(evaluator, evaluator.verb.contacts)
    assert still.max_m < 1e-4
    assert slides.max_m == pytest.approx(0.1, abs=0.003), "0.1 m/s for 2 s, from the middle"
    assert max(still.penetration_m, slides.penetration_m) < 1e-3
    heights = evaluator.verb.contacts.heights + 0.02
    sunk = foot_contact.by_example(evaluator, replace(evaluator.verb.contacts, heights=heights))
    assert sunk[0].penetration_m == pytest.approx(0.02, abs=1e-3)


def test_a_walk_of_planted_feet_hardly_slides_and_its_blends_slide(tmp_path):
    motions = {"slow": walker.walk(1.0), "fast": walker.walk(1.2)}
    evaluator = evaluator_of(tmp_path, motions, looping=True)
    known = evaluator.verb.contacts
    own = foot_contact.example_slides(evaluator, known)
    assert own.stances == 12
    assert own.max_m < 0.01
    between = foot_contact.slides(evaluator, known, np.array([[0.5]]))
    assert between.stances == 6
    assert 0.0 < between.max_m < 0.05


def test_a_verb_stored_without_contacts_is_measured_with_those_found_now(tmp_path):
    evaluator = evaluator_of(tmp_path, {"a": walker.jump(), "b": walker.stand(2.5)})
    bare = Evaluator(replace(evaluator.verb, contacts=None))
    own, found = foot_contact.contacts(evaluator), foot_contact.contacts(bare)
    assert own is evaluator.verb.contacts
    np.testing.assert_array_equal(found.values, own.values)
    np.testing.assert_array_equal(found.heights, own.heights)


def test_a_verb_without_feet_has_no_contacts():
    verb = library.load("arm3")
    assert foot_contact.contacts(Evaluator(verb)) is None
    assert foot_contact.slide_rows(verb) == []
    row = quality_of(verb, "rbf", nodes=7, zoom=False, slide=True)
    assert row.as_dict()["slide_median_m"] is None


def test_feet_that_the_author_planted_hardly_slide():
    verb = library.load("reach")
    rows = foot_contact.slide_rows(verb)
    assert [row["example"] for row in rows] == list(verb.examples)
    assert all(row["stances"] == 6 and row["slide_max_m"] < 1e-3 and row["penetration_m"] < 1e-3 for row in rows)


def test_slides_are_measured_only_on_request():
    verb = library.load("reach")
    assert np.isnan(quality_of(verb, "rbf", nodes=7, zoom=False).slide_max_m)
    assert 0.0 < quality_of(verb, "rbf", nodes=7, zoom=False, slide=True).slide_max_m < 0.05


def test_the_command_evaluates_foot_slide_with_an_option():
    arguments = ["measure", "reach", "--method", "rbf", "--grid", "7", "--feet"]
    shown = CliRunner().invoke(app, arguments)
    assert shown.exit_code == 0
    assert "foot slide, mm" in shown.stdout
    row = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)["methods"]["rbf"]
    assert 0.0 < row["slide_median_m"] <= row["slide_p90_m"] <= row["slide_max_m"] < 0.05


def test_a_blend_at_an_example_slides_as_the_example(mocap, verb_of):
    verb = verb_of("reach")
    evaluator = Evaluator(verb)
    blend = foot_contact.slides(evaluator, verb.contacts, verb.values, method="rbf")
    own = foot_contact.example_slides(evaluator, verb.contacts)
    assert blend.stances == own.stances
    assert blend.median_m == pytest.approx(own.median_m, abs=1e-6)
    assert blend.max_m == pytest.approx(own.max_m, abs=1e-6)


@pytest.mark.parametrize(("name", "median_mm"), [("reach", 5), ("punch", 15), ("kick", 10), ("jump", 10),
                                                 ("locomotion", 15)])  # fmt: skip
def test_captured_feet_slide_by_millimetres_and_blends_more(mocap, verb_of, name, median_mm):
    verb = verb_of(name)
    evaluator = Evaluator(verb)
    own = foot_contact.example_slides(evaluator, verb.contacts)
    assert 0.0 < 1000 * own.median_m < median_mm
    blends = foot_contact.slides(evaluator, verb.contacts, foot_contact.goals(verb), method="corrected")
    assert blends.median_m > own.median_m, "nothing plants feet, so blends slide more than captures"
    assert blends.p90_m < 0.2
