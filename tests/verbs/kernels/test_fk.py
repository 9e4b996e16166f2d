from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from verbs.kernels import fk, quat

PARENTS = np.array([-1, 0, 1, 2, 1, 4, 0, 6, 7, 7])


def some_motion(*batch: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    offsets = rng.normal(size=(len(PARENTS), 3))
    offsets[0] = 0.0
    return rng.normal(size=(*batch, 3)), quat.exp(rng.normal(size=(*batch, len(PARENTS), 3))), offsets


def by_matrices(root, rotations, offsets) -> tuple[np.ndarray, np.ndarray]:
    """One pose by 4×4 matrices: rotations (J, 3, 3) and positions (J, 3)."""
    transforms = np.tile(np.eye(4), (len(PARENTS), 1, 1))
    transforms[:, :3, :3] = Rotation.from_quat(rotations).as_matrix()
    transforms[:, :3, 3] = offsets
    transforms[0, :3, 3] = root
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            transforms[joint] = transforms[parent] @ transforms[joint]
    return transforms[:, :3, :3], transforms[:, :3, 3]


def test_joints_stand_where_matrices_put_them():
    root, rotations, offsets = some_motion(6)
    turns, positions = fk.forward(root, rotations, PARENTS, offsets)
    for frame in range(6):
        expected_turns, expected_positions = by_matrices(root[frame], rotations[frame], offsets)
        np.testing.assert_allclose(quat.to_matrix(turns[frame]), expected_turns, atol=1e-13)
        np.testing.assert_allclose(positions[frame], expected_positions, atol=1e-13)


def test_one_pose_and_a_batch_of_poses_agree():
    root, rotations, offsets = some_motion(2, 3)
    turns, positions = fk.forward(root, rotations, PARENTS, offsets)
    assert turns.shape == (2, 3, 10, 4)
    assert positions.shape == (2, 3, 10, 3)
    one_turns, one_positions = fk.forward(root[1, 2], rotations[1, 2], PARENTS, offsets)
    np.testing.assert_array_equal(one_turns, turns[1, 2])
    np.testing.assert_array_equal(one_positions, positions[1, 2])


def test_the_rest_pose_adds_up_offsets():
    _, _, offsets = some_motion()
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (10, 1))
    _, positions = fk.forward(np.array([1.0, 2.0, 3.0]), rest, PARENTS, offsets)
    np.testing.assert_allclose(positions[9], [1.0, 2.0, 3.0] + offsets[6] + offsets[7] + offsets[9], atol=1e-15)


def test_the_offset_of_the_root_is_not_used():
    root, rotations, offsets = some_motion(4)
    _, positions = fk.forward(root, rotations, PARENTS, offsets)
    offsets[0] = 7.0
    np.testing.assert_array_equal(fk.forward(root, rotations, PARENTS, offsets)[1], positions)


def test_arms_keep_their_lengths():
    root, rotations, offsets = some_motion(50)
    _, positions = fk.forward(root, rotations, PARENTS, offsets)
    lengths = np.linalg.norm(positions[:, 1:] - positions[:, PARENTS[1:]], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(np.linalg.norm(offsets[1:], axis=-1), (50, 1)), atol=1e-13)


def test_a_turned_root_turns_everything_about_itself():
    root, rotations, offsets = some_motion(5)
    _, positions = fk.forward(root, rotations, PARENTS, offsets)
    turn = quat.exp(np.array([0.3, -1.2, 0.5]))
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    _, turned = fk.forward(root, rotations, PARENTS, offsets)
    expected = quat.rotate(turn, positions - root[:, None]) + root[:, None]
    np.testing.assert_allclose(turned, expected, atol=1e-13)


def test_fk_of_the_mirrored_motion_is_the_mirrored_fk():
    root, rotations, offsets = some_motion(8)
    turns, positions = fk.forward(root, rotations, PARENTS, offsets)
    # A mirror at x = 0 keeps turns about x and reverses turns about y and z.
    across, about = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    mirrored_turns, mirrored = fk.forward(root * across, rotations * about, PARENTS, offsets * across)
    np.testing.assert_allclose(mirrored, positions * across, atol=1e-14)
    np.testing.assert_allclose(mirrored_turns, turns * about, atol=1e-14)
