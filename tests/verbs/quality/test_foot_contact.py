import json

import numpy as np
import pytest
from typer.testing import CliRunner

from verbs import library
from verbs.cli import app
from verbs.quality import foot_contact
from verbs.quality.report import quality_of
from verbs.runtime.evaluate import Evaluator

STEP_S, STANCES_S = 0.4, ((0.0, 0.5), (0.9, 1.5), (1.9, 2.6))


def walked(stances_s=STANCES_S, swing_m=0.6, lift_m=0.15):
    """One toe (F, 1, 3) at 60 Hz that is planted during stances and swings ahead, lifted, between two of them."""
    times = np.arange(round(stances_s[-1][1] * foot_contact.RATE_HZ) + 1) / foot_contact.RATE_HZ
    places = np.zeros((len(times), 1, 3))
    for k in range(len(stances_s) - 1):
        begin, end = stances_s[k][1], stances_s[k + 1][0]
        part = np.clip((times - begin) / (end - begin), 0.0, 1.0)
        places[:, 0, 2] += swing_m * (10 * part**3 - 15 * part**4 + 6 * part**5)
        places[:, 0, 1] += lift_m * np.sin(np.pi * part) ** 2
    return times, places


def runs(standing):
    return [(int(first), int(last) - 1) for first, last in foot_contact._runs(standing)]


def test_stances_are_found_where_they_begin_and_end():
    _, places = walked()
    found = runs(foot_contact.detect(places, 0.0)[:, 0])
    known = [(round(begin * foot_contact.RATE_HZ), round(end * foot_contact.RATE_HZ)) for begin, end in STANCES_S]
    assert len(found) == len(known)
    # A swing begins and ends slowly: below the loose speed, a foot counts as standing for two frames more.
    assert np.abs(np.array(found) - known).max() <= 2


def test_a_foot_that_stops_at_once_is_found_to_the_frame():
    """Constant speed between stances, so that nothing is slow but what stands."""
    times, places = walked()
    for k in range(2):
        begin, end = STANCES_S[k][1], STANCES_S[k + 1][0]
        swinging = (times > begin) & (times < end)
        places[swinging, 0, 2] = 0.6 * (k + (times[swinging] - begin) / (end - begin))
    found = runs(foot_contact.detect(places, 0.0)[:, 0])
    known = [(round(begin * foot_contact.RATE_HZ), round(end * foot_contact.RATE_HZ)) for begin, end in STANCES_S]
    assert np.abs(np.array(found) - known).max() <= 1


def test_a_foot_held_still_in_the_air_does_not_stand():
    _, places = walked()
    assert not foot_contact.detect(places + np.array([0.0, 0.2, 0.0]), 0.0).any()


def test_a_foot_that_is_never_sure_to_stand_does_not():
    """Between the two speeds a contact may continue, but not begin."""
    places = np.zeros((60, 1, 3))
    places[:, 0, 2] = 0.2 * np.arange(60) / foot_contact.RATE_HZ
    assert not foot_contact.detect(places, 0.0).any()
    places[20:30, 0, 2] = places[20, 0, 2]
    assert foot_contact.detect(places, 0.0).any()


@pytest.mark.parametrize(("frames", "kept"), [(5, False), (6, True)])
def test_stances_shorter_than_a_tenth_of_a_second_are_dropped(frames, kept):
    standing = np.zeros((40, 1), bool)
    standing[10 : 10 + frames] = True
    assert foot_contact._tidied(standing).any() == kept


@pytest.mark.parametrize(("frames", "closed"), [(3, True), (4, False)])
def test_gaps_shorter_than_60_ms_are_closed(frames, closed):
    standing = np.ones((40, 1), bool)
    standing[20 : 20 + frames] = False
    assert foot_contact._tidied(standing).all() == closed


def test_ends_of_a_motion_are_no_gaps():
    standing = np.ones((40, 1), bool)
    standing[:2] = standing[-2:] = False
    np.testing.assert_array_equal(foot_contact._tidied(standing), standing)


def contact(standing, *, looping=False, cycles=1.0):
    phases = np.linspace(0.0, cycles, len(standing[0]))
    return foot_contact.Contacts(np.array([0]), 0.0, looping, (phases,) * len(standing), standing)


def test_a_planted_foot_does_not_slide_and_a_swinging_one_does_not_count():
    _, places = walked()
    standing = np.zeros((len(places), 1), bool)
    for begin, end in STANCES_S:
        standing[round(begin * foot_contact.RATE_HZ) : round(end * foot_contact.RATE_HZ) + 1] = True
    known = contact((standing,))
    found = foot_contact._distances(known, known.phases[0], places, standing)
    assert len(found) == 3
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_slide_is_the_largest_distance_from_the_mean_place_over_the_ground():
    places = np.zeros((11, 1, 3))
    places[:, 0, 0] = np.linspace(0.0, 0.1, 11)
    places[:, 0, 1] = np.linspace(0.0, 0.9, 11)  # height is no slide
    standing = np.ones((11, 1), bool)
    known = contact((standing,))
    np.testing.assert_allclose(foot_contact._distances(known, known.phases[0], places, standing), [0.05])
    slides = foot_contact.Slides.of(np.array([0.05]))
    assert (slides.stances, slides.median_m, slides.max_m) == (1, 0.05, 0.05)
    assert foot_contact.Slides.of(np.zeros(0)) is foot_contact.NONE


def test_a_loop_counts_each_stance_once_also_one_across_its_seam():
    frames = np.arange(180)
    phases = frames / 60.0
    standing = ((phases % 1.0 > 0.8) | (phases % 1.0 < 0.2))[:, None]
    places = np.zeros((180, 1, 3))
    places[:, 0, 2] = 0.1 * phases
    known = foot_contact.Contacts(np.array([0]), 0.0, True, (phases,), (standing,))
    found = foot_contact._distances(known, phases, places, standing)
    assert found == pytest.approx([0.02], abs=0.002)
    always = foot_contact._distances(known, phases, places, np.ones_like(standing))
    assert always == pytest.approx([0.05], abs=0.002), "one cycle of a foot that stands all the time"


def test_contacts_blend_by_weights_at_canonical_time():
    first, second = np.zeros((11, 1), bool), np.zeros((21, 1), bool)
    first[:6], second[8:] = True, True
    known = foot_contact.Contacts(
        np.array([0]), 0.0, False, (np.linspace(0, 1, 11), np.linspace(0, 1, 21)), (first, second)
    )
    phases = np.array([0.0, 0.2, 0.45, 0.7, 1.0])
    share = known.share(np.array([0.7, 0.3]), phases)[:, 0]
    np.testing.assert_allclose(share, [0.7, 0.7, 1.0, 0.3, 0.3])
    np.testing.assert_allclose(known.share(np.array([1.0, 0.0]), phases)[:, 0], [1, 1, 1, 0, 0])


def test_contacts_of_a_loop_repeat():
    phases = np.linspace(0.0, 3.0, 181)
    standing = (phases % 1.0 < 0.5)[:, None]
    known = foot_contact.Contacts(np.array([0]), 0.0, True, (phases,), (standing,))
    phases = np.array([0.1, 0.7, 1.1, 1.7, 7.1, 7.7])
    np.testing.assert_array_equal(known.share(np.ones(1), phases)[:, 0], [1, 0, 1, 0, 1, 0])


def test_a_verb_without_toes_has_no_contacts():
    verb = library.load("arm3")
    assert foot_contact.contacts(Evaluator(verb)) is None
    row = quality_of(verb, "rbf", nodes=7, zoom=False, slide=True)
    assert row.as_dict()["slide_median_m"] is None


def test_feet_that_the_author_planted_hardly_slide():
    evaluator = Evaluator(library.load("reach"))
    found = foot_contact.contacts(evaluator)
    assert found is not None
    assert foot_contact.example_slides(evaluator, found).max_m < 1e-3


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
    found = foot_contact.contacts(evaluator)
    blend, own = (
        foot_contact.slides(evaluator, found, verb.values, method="rbf"),
        foot_contact.example_slides(evaluator, found),
    )
    assert blend.stances == own.stances
    assert blend.median_m == pytest.approx(own.median_m, abs=1e-6)
    assert blend.max_m == pytest.approx(own.max_m, abs=1e-6)


# Median, 90th percentile and largest slide of the examples, mm, as another program found them on the same captures.
EXAMPLES_MM = {
    "reach": (1.5, 4.7, 10),
    "punch": (10.8, 32, 47),
    "kick": (5, 9, 24),
    "jump": (5.6, 17, 28),
    "locomotion": (5, 12, 32),
}


@pytest.mark.parametrize("name", list(EXAMPLES_MM))
def test_captured_feet_slide_as_far_as_another_program_found(mocap, verb_of, name):
    evaluator = Evaluator(verb_of(name))
    found = foot_contact.contacts(evaluator)
    own = foot_contact.example_slides(evaluator, found)
    mm = 1000 * np.array([own.median_m, own.p90_m, own.max_m])
    np.testing.assert_allclose(mm, EXAMPLES_MM[name], rtol=0.1, atol=0.8)
    blends = foot_contact.slides(evaluator, found, foot_contact.goals(evaluator.verb), method="corrected")
    assert blends.median_m > own.median_m, "nothing plants feet, so blends slide more than captures"
    assert blends.p90_m < 0.15


def test_walks_have_two_stances_to_a_cycle_and_each_foot(mocap, verb_of):
    verb = verb_of("locomotion")
    found = foot_contact.contacts(Evaluator(verb))
    by_name = {name: (p, s) for name, p, s in zip(verb.examples, found.phases, found.standing, strict=True)}
    phases, standing = by_name["Walk"]
    for toe in range(2):
        begins = [phases[first] for first, _ in foot_contact._runs(standing[:, toe]) if phases[first] // 1.0 == 1]
        assert len(begins) == 2
    assert not by_name["Run"][1].any(), "a run's feet hardly slow down"
