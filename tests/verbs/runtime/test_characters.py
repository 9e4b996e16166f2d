from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.verbs.living import FPS, STEP_S, accelerations, joints, own_peak, play, unsigned
from verbs import Characters, Evaluator, library
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.runtime.characters import RESTART_S
from verbs.runtime.sequence import sequence

WALK = np.array([1.2, 0.3, 0.1])


SINGLE = 2e-6
"""What sums in single precision may be off."""


@pytest.fixture(scope="module")
def reach() -> Characters:
    return Characters(Evaluator(library.load("reach")))


def mixes(people: Characters, count: int, seed: int = 0) -> np.ndarray:
    """Adverbs (count, D) inside the domain."""
    chart, values = people.verb.domain.chart, people.verb.values
    shares = np.random.default_rng(seed).dirichlet(np.full(len(values), 0.3), count)
    return chart.adverbs(shares @ chart.points(values))


@pytest.mark.parametrize("name", ["punch", "locomotion", "jump"])
def test_a_resting_character_stands_in_the_pose_of_its_adverbs(characters_of, name):
    people = characters_of(name)
    rows, phases = mixes(people, 12), np.linspace(0.0, 0.95, 12)
    slots = np.array([people.add(row, phase=phase, playing=False) for row, phase in zip(rows, phases, strict=True)])
    window, following = people.window, people._following
    people.window = people._following = None  # following is tested elsewhere
    frames = people.step(slots, STEP_S)
    people.window, people._following = window, following
    poses = people.evaluator.pose(rows, phase=phases)
    np.testing.assert_allclose(frames.blend.weights, poses.blend.weights, atol=1e-12)
    np.testing.assert_allclose(frames.progress["phase"], phases, atol=1e-12)
    np.testing.assert_allclose(frames.progress["time_s"], poses.time_s, atol=1e-12)
    if not people.verb.looping:  # a loop walks from where it was put, not from its phase 0
        np.testing.assert_allclose(frames.root, poses.root, atol=SINGLE)
        np.testing.assert_allclose(frames.rotations, poses.rotations, atol=SINGLE)
    np.testing.assert_allclose(unsigned(frames.rotations)[:, 1:], unsigned(poses.rotations)[:, 1:], atol=SINGLE)
    for slot in slots:
        people.remove(slot)


@pytest.mark.parametrize("name", ["punch", "locomotion"])
def test_a_batch_moves_as_each_one_alone(characters_of, name):
    people = characters_of(name)
    rows, goals = mixes(people, 5, 1), mixes(people, 5, 2)
    pairs = []
    for row, goal in zip(rows, goals, strict=True):
        pair = [people.add(row, phase=0.3, speed=1.5) for _ in range(2)]
        for slot in pair:
            people.aim(slot, people.row(goal))
        pairs.append(pair)
    together, alone = np.array(pairs).T
    root, rotations, _ = play(people, together, 30)
    for b, slot in enumerate(alone):
        single, turns, _ = play(people, int(slot), 30)
        np.testing.assert_allclose(single[:, 0], root[:, b], atol=1e-12)
        np.testing.assert_allclose(turns[:, 0], rotations[:, b], atol=1e-12)
    for slot in np.ravel(pairs):
        people.remove(slot)


@pytest.mark.parametrize(("name", "fps"), [("punch", 60.0), ("locomotion", 60.0), ("kick", 23.0), ("locomotion", 7.0)])
def test_phases_go_on_as_in_a_sequence(characters_of, name, fps):
    """And a loop's root walks on as there, cycle by cycle."""
    people = characters_of(name)
    row = WALK if name == "locomotion" else mixes(people, 1, 3)[0]
    poses = sequence(people.evaluator, row[None], fps, cycles=3 if people.verb.looping else 1, plant=False)
    slot = people.add(row, plant=False)
    root, rotations, frames = play(people, slot, len(poses.phase), step_s=1 / fps)
    phases = np.array([frame.progress["phase"][0] for frame in frames])
    expected = poses.phase % 1.0 if people.verb.looping else poses.phase
    np.testing.assert_allclose(np.abs((phases - expected + 0.5) % 1.0 - 0.5), 0.0, atol=1e-9)
    np.testing.assert_allclose(root[:, 0], poses.root, atol=SINGLE)
    np.testing.assert_allclose(unsigned(rotations[:, 0]), unsigned(poses.rotations), atol=SINGLE)
    people.remove(slot)


def test_the_way_back_undoes_the_way_there(characters_of):
    people = characters_of("locomotion")
    slot = people.add(WALK, plant=False)
    root, rotations, _ = play(people, slot, 200)
    people.set(slot, speed=-1.0)
    back, turns, _ = play(people, slot, 199)
    np.testing.assert_allclose(back[::-1], root[:-1], atol=SINGLE)
    np.testing.assert_allclose(unsigned(turns[::-1]), unsigned(rotations[:-1]), atol=SINGLE)
    people.remove(slot)


def test_a_root_does_not_jolt_where_a_cycle_ends(characters_of):
    people = characters_of("locomotion")
    for row in ([1.2, 0.0, 0.0], WALK, [3.5, 0.0, 0.0], [0.3, 0.0, 0.8]):
        slot = people.add(np.array(row))
        root, _, frames = play(people, slot, 400)
        seams = np.flatnonzero(np.diff([frame.progress["phase"][0] for frame in frames]) < 0)
        pushed = accelerations(root[:, 0, None])[:, 0]
        near = np.zeros(len(pushed), bool)
        for seam in seams:
            near[max(seam - 2, 0) : seam + 2] = True
        assert len(seams) >= 2
        assert pushed[near].max() <= 1.2 * pushed[~near].max()
        people.remove(slot)


def test_speed_and_pause(reach):
    slot = reach.add(speed=2.0)
    _, _, frames = play(reach, slot, 31)
    assert frames[-1].progress["time_s"][0] == pytest.approx(1.0)
    reach.set(slot, speed=0.0)
    _, _, still = play(reach, slot, 3)
    assert all(frame.progress["phase"][0] == frames[-1].progress["phase"][0] for frame in still)
    reach.set(slot, speed=-1.0, playing=False)
    assert play(reach, slot, 3)[2][-1].progress["time_s"][0] == pytest.approx(1.0)
    reach.set(slot, playing=True)
    assert play(reach, slot, 30)[2][-1].progress["time_s"][0] == pytest.approx(0.5)
    reach.set(slot, phase=0.8)
    assert play(reach, slot, 1)[2][0].progress["phase"][0] == 0.8  # the first frame shows the phase
    reach.remove(slot)


def test_a_motion_ends_once_and_holds(reach):
    for speed, end in ((1.0, 1.0), (-2.0, 0.0)):
        slot = reach.add(speed=speed, phase=0.5)
        _, rotations, frames = play(reach, slot, 300)
        ended = np.array([frame.progress["ended"][0] for frame in frames])
        assert ended.sum() == 1
        assert frames[-1].progress["phase"][0] == end
        at = int(ended.argmax())
        np.testing.assert_array_equal(rotations[at:], np.broadcast_to(rotations[at], rotations[at:].shape))
        reach.remove(slot)


@pytest.mark.parametrize("speed", [1.0, -1.0])
@pytest.mark.parametrize("name", ["punch", "kick", "jump"])
def test_a_motion_that_starts_over_passes_from_its_end_to_its_start(characters_of, name, speed):
    """Without a jump in position or velocity, wherever between two frames the end falls."""
    people = characters_of(name)
    for row in mixes(people, 3, 4):
        slot = people.add(row, looping=True, speed=speed, phase=0.9 if speed > 0 else 0.1)
        root, rotations, frames = play(people, slot, 120)
        seam = int(np.argmax([frame.progress["restarted"][0] for frame in frames]))
        passing = [bool(frame.in_transition[0]) for frame in frames]
        assert sum(passing) == pytest.approx(RESTART_S * FPS, abs=1)
        assert passing[seam]
        places = joints(people.verb, root[:, 0], rotations[:, 0])
        pushed = accelerations(places).max(axis=1)
        assert pushed[seam - 3 : seam + 20].max() <= 1.2 * own_peak(people, row, people.verb)
        people.remove(slot)


def test_a_jump_that_starts_over_goes_on_from_where_it_led(characters_of):
    people = characters_of("jump")
    row = np.array([1.5, 0.3, 0.3])
    slot = people.add(row, looping=True)
    seconds = people.evaluator.pose(row[None], phase=0.0).duration_s[0]
    root, _, _ = play(people, slot, int(2 * seconds * FPS) + 1)
    np.testing.assert_allclose(np.linalg.norm(root[-1, 0, [0, 2]]), 2 * 1.5, rtol=0.05)
    assert np.linalg.norm(np.diff(root[:, 0], axis=0), axis=1).max() * FPS < 5.0
    people.remove(slot)


def test_many_cycles_in_a_step(characters_of):
    people = characters_of("locomotion")
    times = np.array([0.0, 10.0, 20.0, 30.0])
    for plant, within in ((False, SINGLE), (True, 2e-3)):
        slot = people.add(WALK, speed=10.0, plant=plant)
        root, rotations, _ = play(people, slot, 4, step_s=1.0)
        poses = people.evaluator.pose_of(people.evaluator.blend(WALK[None]), time_s=times, plant=plant)
        np.testing.assert_allclose(root[:, 0], poses.root, atol=within)
        people.remove(slot)
    people = characters_of("punch")
    slot = people.add(speed=-10.0, looping=True)
    root, rotations, _ = play(people, slot, 10, step_s=1.0)
    assert np.isfinite(root).all()
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1.0, atol=1e-9)
    people.remove(slot)


@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_who_is_held_at_a_seam_does_not_walk(characters_of, phase):
    people = characters_of("locomotion")
    slot = people.add(WALK, phase=phase, playing=False)
    root, _, _ = play(people, slot, 5)
    np.testing.assert_array_equal(root[:, 0, [0, 2]], 0.0)
    people.remove(slot)


@pytest.mark.parametrize("name", ["reach", "punch", "kick"])
def test_a_path_between_goals_stays_in_the_domain(characters_of, name):
    """Also across the cut, by the longer path."""
    people = characters_of(name)
    chart, values = people.verb.domain.chart, people.verb.values
    points = chart.points(values)
    ends = values[[points[:, 0].argmin(), points[:, 0].argmax()]]
    starts, goals = np.concatenate([mixes(people, 20, 5), ends]), np.concatenate([mixes(people, 20, 6), ends[::-1]])
    slots = np.array([people.add(row, playing=False, half_life_s=0.5) for row in starts])
    for slot, goal in zip(slots, goals, strict=True):
        people.aim(slot, people.row(goal))
    _, _, frames = play(people, slots, 120)
    assert not any(frame.blend.clamped.any() for frame in frames)
    weights = np.array([frame.blend.weights for frame in frames])
    assert np.abs(np.diff(weights, axis=0)).max() < 0.5  # no leap across the cut
    for slot in slots:
        people.remove(slot)


def test_who_has_settled_is_not_blended_again(characters_of, monkeypatch):
    people = characters_of("punch")
    start, goal = mixes(people, 2, 7)
    slot = people.add(start, plant=False)
    people.aim(slot, people.row(goal))
    play(people, slot, 120)
    monkeypatch.setattr(people.evaluator, "blend", None)  # calls fail
    _, rotations, (frame,) = play(people, slot, 1)
    monkeypatch.undo()
    chart = people.verb.domain.chart
    settled = chart.adverbs(chart.points(goal[None]))
    fresh = people.evaluator.pose(settled, phase=float(frame.progress["phase"][0]), plant=False)
    np.testing.assert_array_equal(frame.blend.weights, fresh.blend.weights)
    np.testing.assert_array_equal(frame.blend.error, fresh.blend.error)
    np.testing.assert_allclose(rotations[0], fresh.rotations, atol=SINGLE)
    people.remove(slot)


def test_who_is_on_the_way_or_held_at_a_goal_is_restless(reach):
    one, other = mixes(reach, 2)
    slots = np.array([reach.add(one, half_life_s=0.02), reach.add(one, half_life_s=0.0, looping=True)])
    assert reach.restless(slots) == 2  # none has had a frame
    reach.step(slots, STEP_S)
    assert reach.restless(slots) == 0
    for slot in slots:
        reach.aim(int(slot), other)
    assert reach.restless(slots) == 2
    reach.step(slots, STEP_S)
    assert [reach.restless(slots[k : k + 1]) for k in range(2)] == [1, 0]
    for _ in range(60):
        reach.step(slots, STEP_S)
    assert reach.restless(slots) == 0
    reach.set(int(slots[0]), phase=reach.window[0], playing=False)
    reach.step(slots, STEP_S)
    assert reach.restless(slots) == 1
    for slot in slots:
        reach.remove(int(slot))


@pytest.mark.parametrize("name", ["reach", "jump"])
def test_motions_that_start_over_together_do_so_as_each_one_alone(characters_of, name):
    people = characters_of(name)
    rows = mixes(people, 5)
    together, alone = (
        np.array([people.add(row, phase=1.0 - 1e-4 * k, looping=True) for k, row in enumerate(rows)]) for _ in range(2)
    )
    for _ in range(6):
        frames = people.step(together, 2 * STEP_S)
        single = [people.step(alone[k : k + 1], 2 * STEP_S) for k in range(len(rows))]
        np.testing.assert_allclose(frames.root, np.concatenate([one.root for one in single]), atol=SINGLE)
        np.testing.assert_allclose(frames.rotations, np.concatenate([one.rotations for one in single]), atol=SINGLE)
    assert frames.in_transition.all()
    for slot in (*together, *alone):
        people.remove(int(slot))


def test_another_half_life_on_the_way(characters_of):
    people = characters_of("punch")
    start, goal = mixes(people, 2, 7)
    slot = people.add(start, half_life_s=5.0)
    people.aim(slot, people.row(goal))
    play(people, slot, 10)
    people.set(slot, half_life_s=0.0)
    _, _, (frame,) = play(people, slot, 1)
    np.testing.assert_allclose(frame.blend.measured[0], goal, atol=1e-6)
    people.remove(slot)


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"phase": 1.1}, OutOfRange, "phase is 1.1; it must lie between 0 and 1"),
        ({"phase": float("nan")}, OutOfRange, "phase is nan"),
        ({"speed": -10.1}, OutOfRange, "speed is -10.1; it must lie between -10 and 10"),
        ({"half_life_s": -1.0}, OutOfRange, "half_life is -1.0; it must lie between 0 and 10"),
        ({"adverbs": {"x": 0.0}}, RequestError, "missing adverb"),
        ({"adverbs": {"x": 0.0, "y": 1.0, "q": 0.0}}, UnknownName, "unknown adverb 'q'"),
    ],
)
def test_a_wrong_number_leaves_no_character_behind(reach, wrong, error, message):
    before = len(reach)
    with pytest.raises(error, match=message):
        reach.add(**wrong)
    assert len(reach) == before


def test_slots_are_used_again_and_made_more_of(reach):
    before = len(reach)
    slots = [reach.add({"x": -0.3, "y": 1.2, "z": 0.5}) for _ in range(50)]
    assert len(set(slots)) == 50
    assert len(reach) == before + 50
    assert reach.step(np.array(slots), STEP_S).root.shape == (50, 3)
    for slot in slots:
        reach.remove(slot)
    assert len(reach) == before
    assert reach.add() in slots
    assert len(reach) == before + 1


@pytest.fixture(scope="module")
def troupes() -> list[Characters]:
    """Two verbs of one skeleton's names: the built-in reach, and itself."""
    return [Characters(Evaluator(library.load("reach"))) for _ in range(2)]


NUMBERS = st.floats(-2.0, 2.0)
ACTS = st.one_of(
    st.tuples(st.just("add"), st.floats(0, 1), st.floats(-10, 10), st.booleans()),
    st.tuples(st.just("remove"), st.integers(0, 9)),
    st.tuples(st.just("aim"), st.integers(0, 9), NUMBERS, NUMBERS, NUMBERS),
    st.tuples(st.just("set"), st.integers(0, 9), st.floats(0, 1) | st.none(), st.floats(-10, 10), st.booleans()),
    st.tuples(st.just("step"), st.sampled_from([1 / 240, 1 / 60, 0.3, 1.0])),
    st.tuples(st.just("go_on"), st.integers(0, 9), st.sampled_from([0.0, 0.1, 0.3, 5.0]), st.booleans()),
)


def act(troupes, cast, one):
    kind, *rest = one
    if kind == "add":
        who = troupes[len(cast) % 2]
        cast.append((who, who.add(phase=rest[0], speed=rest[1], looping=rest[2])))
    elif kind == "step":
        for troupe in troupes:
            slots = np.array([slot for who, slot in cast if who is troupe], np.int64)
            frames = troupe.step(slots, rest[0])
            assert np.isfinite(frames.root).all()
            assert np.abs(np.linalg.norm(frames.rotations, axis=-1) - 1.0).max(initial=0.0) < 1e-9
            assert np.isfinite(frames.blend.weights).all()
            assert ((frames.progress["phase"] >= 0) & (frames.progress["phase"] <= 1)).all()
    elif cast:
        who, slot = cast[rest[0] % len(cast)]
        if kind == "remove":
            cast.remove((who, slot))
            who.remove(slot)
        elif kind == "aim":
            who.aim(slot, who.row(np.array(rest[1:])))
        elif kind == "set":
            who.set(slot, phase=rest[1], speed=rest[2], playing=rest[3])
        else:
            other = troupes[(troupes.index(who) + 1) % 2]
            cast.remove((who, slot))
            cast.append((other, other.go_on(who, slot, transition_s=rest[1], same=rest[2])))
            who.remove(slot)


@settings(max_examples=60, deadline=None)
@given(acts=st.lists(ACTS, max_size=40))
def test_whatever_is_asked_poses_stay_sound(troupes, acts):
    before = [len(troupe) for troupe in troupes]
    cast: list[tuple[Characters, int]] = []
    for one in [("add", 0.0, 1.0, False), *acts, ("step", STEP_S)]:
        act(troupes, cast, one)
    for troupe, count in zip(troupes, before, strict=True):
        assert len(troupe) == count + sum(who is troupe for who, _ in cast)
    for who, slot in cast:
        who.remove(slot)
    assert [len(troupe) for troupe in troupes] == before
