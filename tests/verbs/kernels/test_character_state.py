from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.verbs.crowds import crowd_of
from verbs.kernels import character_state
from verbs.kernels.character_state import Advanced
from verbs.kernels.chart import IDENTITY, ChartArrays
from verbs.kernels.corrected_position import Blended
from verbs.kernels.following import NO_WINDOW
from verbs.kernels.timewarp import Clock

RATE = 1.6783469900166605  # (1 + x) · exp(-x) is one half here


def plain_chart(dims):
    return ChartArrays(IDENTITY, np.zeros(3, np.int64), np.zeros(4), np.zeros(dims), np.ones(dims))


def steered(goal, steps, *, half_life_s=0.1, shown=None, velocity=None):
    """Path (F, D) of one character that runs after a goal, in steps of these seconds; its velocity at the end."""
    goal = np.atleast_2d(np.asarray(goal, float))
    crowd = crowd_of(1, dims=goal.shape[1])
    crowd.state["decay"][0] = RATE / half_life_s if half_life_s else 0.0
    crowd.goals[:] = goal
    crowd.shown[:] = 0.0 if shown is None else shown
    crowd.velocity[:] = 0.0 if velocity is None else velocity
    path, counts, moved = [], [], np.empty(1, np.int64)
    for step_s in steps:
        counts.append(character_state.steer(np.zeros(1, np.int64), step_s, crowd, plain_chart(goal.shape[1]), moved))
        path.append(crowd.shown[0].copy())
    return np.array(path), crowd.velocity, counts


@pytest.mark.parametrize("half_life_s", [0.01, 0.1, 2.0])
def test_half_of_the_way_is_done_after_the_half_life(half_life_s):
    path, _, _ = steered([[1.0, -2.0]], [half_life_s / 8] * 8, half_life_s=half_life_s)
    np.testing.assert_allclose(path[-1], [0.5, -1.0], atol=1e-6)


def test_a_goal_is_not_overshot():
    path, _, _ = steered([[1.0, -2.0, 0.0]], [1 / 60] * 300)
    assert np.all(np.diff(path[:, 0]) >= 0)
    assert path[:, 0].max() <= 1.0
    assert np.all(np.diff(path[:, 1]) <= 0)
    assert path[:, 1].min() >= -2.0
    assert np.all(path[:, 2] == 0.0)


@pytest.mark.parametrize("parts", [2, 7, 100])
def test_steps_of_any_size_lead_to_one_place(parts):
    rng = np.random.default_rng(0)
    goal, shown, velocity = rng.normal(size=(3, 1, 3))
    whole = steered(goal, [0.13], shown=shown, velocity=velocity)
    divided = steered(goal, [0.13 / parts] * parts, shown=shown, velocity=velocity)
    np.testing.assert_allclose(divided[0][-1], whole[0][-1], atol=1e-12)
    np.testing.assert_allclose(divided[1], whole[1], atol=1e-12)


def test_a_half_life_of_zero_is_at_once():
    path, velocity, _ = steered([[3.0, 4.0]], [1 / 60], half_life_s=0.0, velocity=np.ones((1, 2)))
    assert path[0].tolist() == [3.0, 4.0]
    assert not velocity.any()


def test_a_goal_is_reached_exactly_and_then_nothing_moves():
    path, velocity, counts = steered([[0.3, -0.7]], [1 / 60] * 240)
    assert path[-1].tolist() == [0.3, -0.7]
    assert not velocity.any()
    assert counts[0] == 1
    assert counts[-1] == 0
    assert counts.index(0) < 120  # within two seconds, at the default half-life
    assert not any(counts[counts.index(0) :])


def test_only_those_that_move_are_said_to():
    crowd = crowd_of(4, dims=2)
    crowd.known[2] = 0
    crowd.goals[1] = 1.0
    slots, moved = np.array([3, 2, 1]), np.empty(3, np.int64)
    count = character_state.steer(slots, 0.1, crowd, plain_chart(2), moved)
    assert moved[:count].tolist() == [1, 2]  # one is new, one has another goal
    weights, phases = np.eye(2), np.array([0.0, 1.0])
    fresh = Blended(weights, np.zeros((2, 0)), np.zeros(2), np.zeros(2))
    crowd = crowd._replace(weights=np.zeros((4, 3, 2)), keytimes=np.zeros((4, 2)), slopes=np.zeros((4, 2)))
    character_state.keep(slots, moved[:count], fresh, Clock(phases, np.log([[2.0], [3.0]]), False), crowd)
    assert crowd.known.tolist() == [1, 1, 1, 1]
    np.testing.assert_allclose(crowd.keytimes[:, 1], [0.0, 3.0, 2.0, 0.0])
    assert np.isnan(crowd.state["seconds"]).tolist() == [False, True, True, False]


def test_weights_of_the_last_two_frames_stay():
    crowd, slot, phases = crowd_of(1, keytimes=2), np.zeros(1, np.int64), np.array([0.0, 1.0])
    clock = Clock(phases, np.zeros((1, 1)), False)
    for k in range(7):
        fresh = Blended(np.array([[float(k)]]), np.zeros((1, 0)), np.zeros(1), np.zeros(1))
        character_state.keep(slot, slot, fresh, clock, crowd)
        row = crowd.state[0]
        shown = [crowd.weights[0, row[name], 0] for name in ("weights", "weights_1", "weights_2")]
        assert shown == [max(k - n, 0) for n in range(3)]
        character_state.displayed(0.1, row)


PHASES = np.array([0.0, 0.4, 1.0])
LENGTHS = np.log([[0.5, 1.5]])  # one example of 2 s


def advanced(phase, *, speed=1.0, loop=0.0, looping=False, steps=(0.1,), fresh=0.0, playing=1.0):
    """Progress (F,) of one character, step by step, and its state."""
    crowd, clock, slot = crowd_of(1), Clock(PHASES, LENGTHS, looping), np.zeros(1, np.int64)
    state = crowd.state
    for name, value in (("phase", phase), ("speed", speed), ("playing", playing), ("looping", loop), ("fresh", fresh)):
        state[name] = value
    weights = Blended(np.ones((1, 1)), np.zeros((1, 0)), np.zeros(1), np.zeros(1))
    character_state.keep(slot, slot, weights, clock, crowd)
    rows = []
    for step_s in steps:
        flags, which = np.zeros((2, 1), np.bool_), np.zeros((2, 1), np.int64)
        frame = Advanced(np.zeros(1, character_state.PROGRESS), np.zeros(1), *flags, *which)
        character_state.advance(slot, step_s, crowd, clock, np.zeros((0, 1, 4)), NO_WINDOW, frame)
        state["fresh"][0] = 0.0
        rows.append(frame.progress[0])
    return np.array(rows), state[0]


def test_seconds_pass_at_the_speed_that_is_set():
    for speed in (1.0, 2.0, 0.3, -1.0):
        rows, _ = advanced(0.5, speed=speed, steps=[0.1, 0.05])
        again, _ = advanced(0.5, speed=0.0)
        np.testing.assert_allclose(rows["time_s"] - again["time_s"][0], np.array([0.1, 0.15]) * speed, atol=1e-12)
        np.testing.assert_allclose(rows["duration_s"], 2.0)


@pytest.mark.parametrize(("speed", "start", "end"), [(1.0, 0.9, 1.0), (10.0, 0.0, 1.0), (-1.0, 0.1, 0.0)])
def test_an_end_is_reported_once_and_holds(speed, start, end):
    rows, state = advanced(start, speed=speed, steps=[0.3] * 12)
    ended = rows["ended"]
    assert ended.sum() == 1
    after = rows["phase"][int(ended.argmax()) :]
    assert np.all(after == end)
    assert state["playing"] == 0.0
    assert rows["passed"][int(ended.argmax()) + 1 :].sum() == 0


@pytest.mark.parametrize("looping", [True, False])
def test_a_loop_goes_round(looping):
    rows, _ = advanced(0.0, loop=1.0, looping=looping, steps=[0.7] * 9)
    np.testing.assert_allclose(rows["time_s"], 0.7 * np.arange(1, 10) % 2.0, atol=1e-9)
    assert rows["restarted"].sum() == (0 if looping else 3)
    back, _ = advanced(0.0, loop=1.0, looping=looping, speed=-1.0, steps=[0.7] * 9)
    np.testing.assert_allclose(back["time_s"], -0.7 * np.arange(1, 10) % 2.0, atol=1e-9)
    gone = [np.sum(way["stop"] - way["start"]) for way in (rows, back)]
    np.testing.assert_allclose(gone, [3 + rows["phase"][-1], back["phase"][-1] - 4], atol=1e-12)


@pytest.mark.parametrize("looping", [True, False])
def test_who_is_held_at_the_end_of_a_loop_stays_there(looping):
    """Its end is the start of the next cycle, which has not been walked."""
    for kept in ({"speed": 0.0}, {"playing": 0.0}, {"fresh": 1.0}, {"speed": -1.0, "fresh": 1.0}):
        rows, _ = advanced(1.0, loop=1.0, looping=looping, **kept)
        assert rows["phase"][0] == 1.0
        assert rows["restarted"][0] == 0.0
        assert abs(rows["stop"][0] - rows["start"][0]) < 2e-9


def test_many_cycles_in_one_step():
    rows, _ = advanced(0.2, loop=1.0, looping=True, speed=10.0, steps=[1.0])
    assert rows["stop"][0] == pytest.approx(5.2)
    assert rows["passed"][0] == 1.0


def test_keytimes_pass_where_they_are_and_nowhere_else():
    rows, _ = advanced(0.0, steps=[0.2] * 10, fresh=1.0)
    assert np.flatnonzero(rows["passed"]).tolist() == [
        0,
        3,
    ]  # the start; 0.5 s, as the first frame stands
    back, _ = advanced(1.0, speed=-1.0, steps=[0.2] * 14, fresh=1.0)
    assert np.flatnonzero(back["passed"][:9]).tolist() == [0, 8]
    assert back["passed"][np.argmax(back["ended"])] == 1.0  # the start, as it is reached


def walked(state, start, stop, weights, strides):
    progress = np.zeros(1, character_state.PROGRESS)
    progress["start"], progress["stop"] = start, stop
    character_state.walk(np.zeros(1, np.int64), state, weights, strides, progress)
    return np.array(state[["x", "y", "z", "heading"]][0].tolist())


def test_walking_back_undoes_walking_forward():
    rng = np.random.default_rng(1)
    strides, weights = rng.normal(size=(9, 2, 4)) * 0.2, np.array([[0.7, 0.3]])
    state = np.zeros(1, character_state.CHARACTER)
    state["x"], state["y"], state["z"], state["heading"] = 1.0, 4.0, 2.0, 3.0
    marks = [0.0, 0.05, 0.31, 0.99, 1.02, 2.7]
    seen = [np.array([1.0, 4.0, 2.0, 3.0])]
    seen += [walked(state, start, stop, weights, strides) for start, stop in itertools.pairwise(marks)]
    for k in range(len(marks) - 1, 0, -1):
        cycle = np.floor(marks[k])
        back = walked(state, marks[k] - cycle, marks[k - 1] - cycle, weights, strides)
        np.testing.assert_allclose(back, seen[k - 1], atol=1e-12)
