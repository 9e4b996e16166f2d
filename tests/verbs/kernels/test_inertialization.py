from __future__ import annotations

import itertools

import numpy as np

from tests.verbs.crowds import NO_LEGS, crowd_of
from tests.verbs.sources import SKELETON
from verbs.kernels import inertialization, quat


def test_what_is_left_starts_as_it_was_ends_at_rest_and_is_never_pushed_hard():
    shares = np.linspace(0.0, 1.0, 2_001)
    keep, carry = np.array([inertialization._factors(u) for u in shares]).T
    step = shares[1]
    speed, push = (np.array([np.diff(one, n) / step**n for one in (keep, carry)]) for n in (1, 2))
    np.testing.assert_allclose([keep[0], carry[0], keep[-1], carry[-1]], [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(speed[:, 0], [0.0, 1.0], atol=3 * step)
    np.testing.assert_allclose(speed[:, -1], [0.0, 0.0], atol=3 * step)
    np.testing.assert_allclose(np.abs(push).max(axis=1), [100 / 21, 5 / 2], rtol=1e-6)  # bounded: no speed jumps
    assert np.abs(speed[0]).max() < 10 / 7 + 1e-9
    assert carry.min() >= 0.0
    assert carry.max() < 0.21


def turning(rng, joints: int):
    """A pose function of time: root (1, 3) and rotations (1, J, 4), turning evenly."""
    start, rates = quat.exp(rng.normal(size=(joints, 3))), 2.0 * rng.normal(size=(joints, 3))
    place, velocity = rng.normal(size=(2, 3))

    def at(time_s: float):
        return (place + velocity * time_s)[None], quat.mul(quat.exp(rates * time_s), start)[None]

    return at


def passed_over(step_s: float, length: float = 0.3):
    """Frames (F, 3 + 4·J) that pass from one motion to another, and the number of those before the seam."""
    rng = np.random.default_rng(3)
    source, target = turning(rng, len(SKELETON)), turning(rng, len(SKELETON))
    slot, width = np.zeros(1, np.int64), 3 + 4 * len(SKELETON)
    crowd, last, offsets = crowd_of(1), np.zeros((1, 2, width)), np.zeros((1, 2, width - len(SKELETON)))
    state = crowd.state
    state["held"] = 0
    frames = []
    before, after = round(0.1 / step_s), round((length + 0.1) / step_s)
    for k in range(-before, after):
        if k == 1:
            ahead = np.array([np.append(*(part.ravel() for part in target(n * step_s))) for n in range(2)])
            inertialization.begin(step_s, last[0], ahead, NO_LEGS, offsets[0])
            state["since_s"], state["transition_s"] = 0.0, length
        root, rotations = (source if k <= 0 else target)(k * step_s)
        inertialization.apply(slot, step_s, crowd, offsets, last, False, NO_LEGS, root, rotations)
        frames.append(last[0, 1].copy())
    assert state["transition_s"][0] == 0.0
    np.testing.assert_allclose(frames[-1], np.append(*(part.ravel() for part in target((after - 1) * step_s))))
    frames = np.array(frames)
    quaternions = frames[:, 3:].reshape(len(frames), -1, 4)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=2), 1.0, atol=1e-12)
    flips = np.sign((quaternions[1:] * quaternions[:-1]).sum(2)).cumprod(0)  # q and -q are one rotation
    quaternions[1:] *= flips[..., None]
    return np.concatenate([frames[:, :3], quaternions.reshape(len(frames), -1)], axis=1), before


def test_a_transition_has_no_jump_in_position_or_velocity():
    """Steps shrink with the frame's length, and differences between steps with its square, at both seams too."""
    sizes = []
    for step_s in (0.01, 0.005, 0.0025):
        frames, _ = passed_over(step_s)
        sizes.append((np.abs(np.diff(frames, axis=0)).max(), np.abs(np.diff(frames, 2, axis=0)).max()))
    for coarse, fine in itertools.pairwise(sizes):
        assert 1.8 < coarse[0] / fine[0] < 2.2
        assert 3.5 < coarse[1] / fine[1] < 4.5


def test_half_a_turn_goes_the_same_way_as_before():
    """An offset that grows past half a turn is read as more than half, so that its velocity is the true one."""
    step_s, rate, last, ahead = 0.01, 3.0, np.zeros((2, 7)), np.zeros((2, 7))
    ahead[:, 6] = 1.0
    for row, angle in enumerate((np.pi - 0.02, np.pi + 0.01)):
        last[row, 3:] = quat.exp(np.array([0.0, angle, 0.0]))
    offsets = np.empty((2, 6))
    inertialization.begin(step_s, last, ahead, NO_LEGS, offsets)
    np.testing.assert_allclose(np.abs(offsets[0, 4]), np.pi - 0.01, atol=1e-12)
    np.testing.assert_allclose(offsets[1, 3:], [0.0, rate, 0.0], atol=1e-9)


def test_a_step_back_is_as_long_as_the_one_ahead():
    frames = np.zeros((2, 11))
    frames[:, :3] = [[0.0, 1.0, 2.0], [0.5, 1.0, 1.0]]
    vectors = np.array([[[0.0, 0.0, 0.3], [0.1, 0.0, 0.0]], [[0.0, 0.0, 0.4], [0.3, 0.0, 0.0]]])
    frames[:, 3:] = quat.exp(vectors).reshape(2, 8)
    inertialization.step_back(frames)
    np.testing.assert_allclose(frames[:, :3], [[-0.5, 1.0, 3.0], [0.0, 1.0, 2.0]])
    expected = quat.exp(np.array([[[0.0, 0.0, 0.2], [-0.1, 0.0, 0.0]], vectors[0]])).reshape(2, 8)
    np.testing.assert_allclose(frames[:, 3:], expected, atol=1e-12)


def test_where_a_character_appears_it_does_not_move():
    """Else a switch right after a seek would carry on the leap."""
    crowd, last = crowd_of(1), np.full((1, 2, 7), 9.0)
    state = crowd.state
    state["fresh"][0], state["held"][0] = 1.0, 0
    root, rotations = np.array([[1.0, 2.0, 3.0]]), np.array([[[0.0, 0.0, 0.0, 1.0]]])
    offsets = np.zeros((1, 2, 6))
    inertialization.apply(np.zeros(1, np.int64), 0.1, crowd, offsets, last, False, NO_LEGS, root, rotations)
    np.testing.assert_array_equal(last[0, 0], last[0, 1])
    assert state["step_s"][0] == 0.1
    assert state["fresh"][0] == 0.0
