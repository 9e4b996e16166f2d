from __future__ import annotations

import numpy as np
import pytest

from tests.verbs.living import FPS, accelerations, joints, own_peak, play
from verbs import Characters, Evaluator, library
from verbs.kernels import following

REACHING = ["reach", "punch", "kick"]


def circle(centre: np.ndarray) -> np.ndarray:
    """Goals (F, 3) on a circle, one frame each: two seconds for a turn."""
    angles = 2 * np.pi * 0.5 * np.arange(2 * FPS) / FPS
    return centre + 0.06 * np.stack([np.cos(angles) - 1, np.sin(angles), 0 * angles], axis=1)


def inside(people: Characters) -> np.ndarray:
    """A place (3,) about which a circle lies inside the domain."""
    domain, chart = people.verb.domain, people.verb.domain.chart
    for point in chart.points(people.verb.values):
        centre = chart.adverbs((0.7 * domain.middle + 0.3 * point)[None])[0]
        if not people.evaluator.clamp(circle(centre))[1].any():
            return centre
    raise AssertionError("the domain is too small")


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("reach", (0.75, 0.95), (1.02, 1.2)), *((n, (0.88, 0.98), (1.0, 1.1)) for n in REACHING[1:])],
)
def test_the_window_is_where_correction_stays_small(characters_of, name, low, high):
    people = characters_of(name)
    start, end = people.window
    keytime = people.verb.phases[people.verb.measure.keytime]
    assert start <= keytime <= end
    assert low[0] <= start / keytime <= low[1]
    assert high[0] <= end / keytime <= high[1]


@pytest.mark.parametrize("name", ["jump", "locomotion"])
def test_what_is_not_measured_by_a_joint_has_no_window(verb_of, name):
    assert Evaluator(verb_of(name)).follow_window() is None


def test_a_verb_of_styles_has_no_window():
    evaluators = [Evaluator(library.load(name)) for name in library.names()]
    styles = [one for one in evaluators if one.verb.measure.kind == 0]
    assert all(one.follow_window() is None for one in styles)
    assert all(one.follow_window() for one in evaluators if "corrected" in one.verb.bases and one not in styles)


@pytest.mark.parametrize("part", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("name", REACHING)
def test_a_held_hand_follows_its_goal(characters_of, name, part):
    people = characters_of(name)
    verb, (start, end), centre = people.verb, people.window, inside(people)
    slot = people.add(centre, phase=(1 - part) * start + part * end, playing=False)
    for frame, requested in enumerate(circle(centre)):
        people.aim(slot, people.row(requested))
        root, rotations, (shown,) = play(people, slot, 1)
        goal = verb.domain.chart.adverbs(people.crowd.shown[slot][None])
        hand = joints(verb, root[0], rotations[0])[:, verb.measure.effector]
        miss = np.linalg.norm(hand - people.evaluator.goal.points(goal), axis=1)[0]
        assert miss < 1e-6, frame
        assert not shown.blend.clamped[0]
        assert shown.blend.error[0] == pytest.approx(miss, abs=1e-6)  # live poses are summed in single precision
    people.remove(slot)


@pytest.mark.parametrize("name", REACHING)
def test_weights_outside_the_window_are_those_of_the_keytime(characters_of, name):
    people = characters_of(name)
    start, end = people.window
    expected = people.evaluator.blend(inside(people)[None]).weights
    for phase in (0.0, start - 0.005, end + 0.005, 1.0):
        slot = people.add(inside(people), phase=phase, playing=False)
        _, _, (shown,) = play(people, slot, 1)
        np.testing.assert_allclose(shown.blend.weights, expected, atol=1e-12)
        people.remove(slot)


@pytest.mark.parametrize("name", REACHING)
def test_holding_and_letting_go_do_not_jolt(characters_of, name):
    """Where time stops joints stop too. Beside these frames nothing is pushed harder than in the verb itself, or than
    the way to the goal needs: a quintic over d metres and T seconds peaks at 5.77 d / T².
    """
    people = characters_of(name)
    start, end = people.window
    slot = people.add(inside(people), phase=start - 0.1)
    places, seams, way = [], [], 0.0
    for frame in range(150):
        if (not seams and start <= people.phase(slot) <= end) or (len(seams) == 1 and frame - seams[0] == 40):
            people.set(slot, playing=bool(seams))
            seams.append(frame)
        root, rotations, (shown,) = play(people, slot, 1)
        way = float(shown.blend.error[0]) if seams == [frame] else way
        places.append(joints(people.verb, root[0], rotations[0])[0])
    people.remove(slot)
    stop, go = seams
    pushed, steps = accelerations(np.array(places)).max(axis=1), np.diff(places, axis=0)
    seam = np.isin(np.arange(1, len(places) - 1), [stop - 1, go - 1, go])
    peak = own_peak(people, inside(people), people.verb)
    # A kick is held half a metre off its goal at the window's first phase; with the weights that bring its foot there
    # it continues 1.7 times as fast, until these have faded.
    bound = {"kick": 1.55}.get(name, 1.2)
    assert pushed[~seam].max() <= bound * max(peak, 5.77 * way / following.FADE_S**2)
    lengths = np.linalg.norm(steps, axis=-1).max(axis=1)
    assert lengths.max() <= 1.8 * lengths[: stop - 1].max()
    assert lengths[stop + 14 : go - 1].max() < 1e-9  # the fade has ended: it stands


def test_a_goal_is_followed_at_once_where_a_held_pose_appears(characters_of):
    people = characters_of("reach")
    slot = people.add(inside(people), phase=people.window[0], speed=0.0)
    _, _, (shown,) = play(people, slot, 1)
    assert shown.blend.error[0] < 1e-6
    assert people.state["share"][slot] == 1.0
    people.remove(slot)


def test_only_corrected_weights_follow(characters_of, verb_of):
    assert Characters(Evaluator(verb_of("reach")), "rbf").window is None


def test_a_motion_that_plays_on_out_of_the_window_is_not_thrown(characters_of):
    """Correction at phases beyond the window would need huge weights: 6.9 times the kick's own peak."""
    people = characters_of("kick")
    for row in people.verb.values[:6]:
        slot = people.add(row, phase=people.window[1], playing=False)
        play(people, slot, 3)
        people.set(slot, playing=True)
        root, rotations, _ = play(people, slot, 30)
        pushed = accelerations(joints(people.verb, root[:, 0], rotations[:, 0]))
        assert pushed.max() <= 2.4 * own_peak(people, row, people.verb)
        people.remove(slot)
