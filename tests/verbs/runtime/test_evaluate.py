import numpy as np
import pytest

from tests import oracle
from tests.verbs.sources import arm_source
from verbs.authoring.fit import build
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.kernels import fk
from verbs.runtime.evaluate import Evaluator


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Evaluator:
    return Evaluator(build(arm_source(tmp_path_factory.mktemp("arm"))).verb)


def test_pose_equals_the_plain_twin(mocap, verb_of):
    evaluator = Evaluator(verb_of("punch"))
    rng = np.random.default_rng(0)
    mixes = rng.dirichlet(np.full(21, 0.3), 20) @ evaluator.verb.values
    phases = rng.uniform(0, 1, 20)
    poses = evaluator.pose(mixes, phase=phases, plant=False)
    for b in range(20):
        root, rotations = oracle.pose(evaluator.verb, poses.blend.weights[b], phases[b])
        np.testing.assert_allclose(poses.root[b], root, atol=1e-12)
        np.testing.assert_allclose(poses.rotations[b], rotations, atol=1e-12)
        assert poses.time_s[b] == pytest.approx(oracle.time_at(evaluator.verb, poses.blend.weights[b], phases[b]))
    turns, places = evaluator.positions(poses)
    skeleton = evaluator.verb.skeleton
    again = fk.forward(poses.root, poses.rotations, skeleton.parents, skeleton.offsets)
    np.testing.assert_allclose(turns, again[0], atol=1e-12)
    np.testing.assert_allclose(places, again[1], atol=1e-12)


def test_measured_value_is_where_the_pose_puts_the_effector(mocap, verb_of):
    evaluator = Evaluator(verb_of("kick"))
    verb = evaluator.verb
    mixes = np.random.default_rng(1).dirichlet(np.full(12, 0.3), 50) @ verb.values
    poses = evaluator.pose(mixes, phase=np.full(50, verb.phases[verb.measure.keytime]))
    _, places = evaluator.positions(poses)
    np.testing.assert_allclose(places[:, verb.measure.effector], poses.blend.measured, atol=1e-12)
    distance = np.linalg.norm(poses.blend.measured - mixes, axis=1)
    np.testing.assert_allclose(poses.blend.error, distance, atol=1e-12)


def test_a_batch_equals_its_single_poses(arm):
    rng = np.random.default_rng(2)
    rows, phases = rng.uniform(0, 1, (300, 2)), rng.uniform(0, 1, 300)
    batch = arm.pose(rows, phase=phases)
    for b in range(0, 300, 7):
        single = arm.pose(rows[b : b + 1], phase=float(phases[b]))
        np.testing.assert_allclose(single.rotations[0], batch.rotations[b], rtol=0, atol=1e-10)
        np.testing.assert_allclose(single.blend.weights[0], batch.blend.weights[b], rtol=0, atol=1e-10)
        assert single.time_s[0] == pytest.approx(batch.time_s[b], abs=1e-12)


def test_phase_and_time_are_inverse(arm):
    rows = np.random.default_rng(3).uniform(0, 0.8, (20, 2))
    phases = np.linspace(0, 1, 20)
    first = arm.pose(rows, phase=phases)
    second = arm.pose(rows, time_s=first.time_s)
    np.testing.assert_allclose(second.phase, phases, atol=1e-9)
    np.testing.assert_allclose(second.rotations, first.rotations, atol=1e-9)


def test_past_the_end_the_last_pose_holds(arm):
    last = arm.pose(arm.verb.values[:1], phase=1.0)
    later = arm.pose(arm.verb.values[:1], time_s=3000.0)
    np.testing.assert_array_equal(last.rotations, later.rotations)
    assert later.time_s[0] == later.duration_s[0]


def test_keytimes_of_an_example_are_met_in_seconds(arm):
    for i, marks in enumerate(arm.verb.keytimes):
        poses = arm.pose(arm.verb.values[i : i + 1], phase=arm.verb.phases)
        np.testing.assert_allclose(poses.time_s, marks, atol=1e-9)


def test_far_adverbs_are_clamped_and_said_to_be(arm):
    blend = arm.blend(np.array([[50.0, -80.0], *arm.verb.values[:1]]))
    assert blend.clamped.tolist() == [True, False]
    assert np.abs(blend.weights).sum(axis=1).max() < 8
    assert blend.error[0] > 50


@pytest.mark.parametrize(
    ("adverbs", "options", "error", "message"),
    [
        ({"x": 0.1}, {}, RequestError, "missing adverb y; this verb needs x, y"),
        ({"x": 0.1, "q": 0.2}, {}, UnknownName, "unknown adverb 'q'; known: x, y"),
        ({"x": 0.1, "y": 0.2, "z": 1.0}, {}, UnknownName, "unknown adverb 'z'"),
        ({"x": float("nan"), "y": 0.2}, {}, OutOfRange, "adverb 'x' is nan; it must be a finite number"),
        (
            {"x": 1e30, "y": 0.2},
            {},
            OutOfRange,
            r"'x' is 1e\+30; it must be a finite number of magnitude 1,000,000,000",
        ),
        ({"x": 0.1, "y": float("inf")}, {}, OutOfRange, "adverb 'y' is inf"),
        ({"x": 0.1, "y": 0.2}, {"phase": 1.5}, OutOfRange, "phase is 1.5; it must lie between 0 and 1"),
        ({"x": 0.1, "y": 0.2}, {"phase": float("nan")}, OutOfRange, "phase is nan"),
        ({"x": 0.1, "y": 0.2}, {"time_s": -1.0}, OutOfRange, "time is -1.0"),
        ({"x": 0.1, "y": 0.2}, {"time_s": 1.0, "phase": 0.5}, RequestError, "not both"),
        ({"x": 0.1, "y": 0.2}, {"method": "magic"}, UnknownName, "unknown method 'magic'; known: rbf"),
        (np.zeros((4, 3)), {}, OutOfRange, r"shape \(batch, 2\): x, y"),
        (np.zeros((4, 2)), {"phase": np.zeros(3)}, OutOfRange, "3 instants for 4 sets of adverbs"),
    ],
)
def test_a_bad_request_is_a_typed_error(arm, adverbs, options, error, message):
    with pytest.raises(error, match=message):
        arm.pose(adverbs, **options)


def test_a_loop_has_no_jump_at_the_seam(mocap, verb_of):
    """Position and velocity of every joint are continuous across the end of a cycle, for blends too."""
    evaluator = Evaluator(verb_of("locomotion"))
    rows = np.random.default_rng(4).dirichlet(np.full(19, 0.3), 8) @ evaluator.verb.values
    for row in rows:
        blend = evaluator.blend(row[None])
        length = evaluator.pose_of(blend, phase=0.0).duration_s[0]
        step = 1e-4
        poses = evaluator.pose_of(blend, time_s=length + step * np.arange(-3, 4))
        _, places = evaluator.positions(poses)
        moves = np.diff(places, axis=0) / step
        assert np.abs(np.diff(places, axis=0)).max() < 20 * step  # nothing moves faster than 20 m/s
        assert np.abs(np.diff(moves, axis=0)).max() < 400 * step * 3  # nor is pushed harder than 3 × 400 m/s²


def test_a_loop_walks_on_from_cycle_to_cycle(mocap, verb_of):
    evaluator = Evaluator(verb_of("locomotion"))
    verb = evaluator.verb
    walk = evaluator.blend(np.array([[1.0, 0.4, 0.0]]))
    poses = evaluator.pose_of(walk, phase=np.array([0.0, 1.0, 2.0, 3.0]))
    steps = np.diff(poses.root[:, [0, 2]], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-9)
    turn = np.arctan2(steps[:, 0], steps[:, 1])
    per_cycle = walk.measured[0, 1] * poses.duration_s[0]
    np.testing.assert_allclose(np.diff(np.unwrap(turn)), per_cycle, atol=1e-9)
    np.testing.assert_allclose(poses.root[:, 1], poses.root[0, 1], atol=1e-6)
    assert verb.measure.unit == "m/s"


def test_root_velocity_is_the_derivative_of_the_walk(mocap, verb_of):
    evaluator = Evaluator(verb_of("locomotion"))
    blend = evaluator.blend(np.array([[1.2, 0.0, 0.1]]))
    times = np.linspace(0.05, 0.9, 12)
    step = 1e-5
    before, here, after = (evaluator.pose_of(blend, time_s=times + shift) for shift in (-step, 0.0, step))
    moved = np.linalg.norm((after.root - before.root)[:, [0, 2]], axis=1) / (2 * step)
    np.testing.assert_allclose(np.linalg.norm(here.root_velocity[:, :2], axis=1), moved, rtol=1e-4)


def test_threads_get_what_one_gets(arm):
    from concurrent.futures import ThreadPoolExecutor

    rows = np.random.default_rng(5).uniform(0, 0.8, (64, 2))
    alone = [arm.pose(row[None], phase=0.4).rotations for row in rows]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda row: arm.pose(row[None], phase=0.4).rotations, rows))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)
