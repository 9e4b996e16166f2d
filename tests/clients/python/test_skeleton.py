"""Quaternions and forward kinematics, against matrices."""

import numpy as np
import pytest
from adverb_client import DecodeError, Skeleton, quat

FIELDS = {
    "names": ["a", "b", "c", "d"],
    "parents": [-1, 0, 1, 0],
    "offsets": [[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 2]],
    "tips": [{"parent": 2, "offset": [0.0, 0.5, 0.0]}],
}


def matrix(q):
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def random_turns(*shape):
    turns = np.random.default_rng(3).normal(size=(*shape, 4))
    return turns / np.linalg.norm(turns, axis=-1, keepdims=True)


def test_products_and_rotations_are_those_of_matrices():
    a, b = random_turns(2)
    np.testing.assert_allclose(matrix(quat.mul(a, b)), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(quat.rotate(a, np.array([1.0, 2.0, 3.0])), matrix(a) @ [1, 2, 3], atol=1e-12)


def test_slerp_takes_the_shorter_arc_and_extrapolates():
    a = np.array([0.0, 0.0, 0.0, 1.0])
    b = np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    for share in (0.0, 0.3, 1.0, 2.5):
        expected = [0.0, 0.0, np.sin(0.2 * share), np.cos(0.2 * share)]
        for end in (b, -b):
            np.testing.assert_allclose(quat.slerp(a, end, share), expected, atol=1e-12)
    np.testing.assert_allclose(quat.slerp(a, a, 0.4), a)
    tiny = np.array([0.0, 0.0, 1e-7, 1.0])
    np.testing.assert_allclose(quat.slerp(a, tiny, 0.5), [0, 0, 5e-8, 1], atol=1e-15)


def test_positions_are_those_of_matrices():
    skeleton = Skeleton.from_json(FIELDS)
    turns, root = random_turns(5, 4), np.arange(15.0).reshape(5, 3)
    places = skeleton.positions(root, turns)
    for k in range(5):
        world = [matrix(turns[k, 0])]
        world += [world[0] @ matrix(turns[k, 1])]
        world += [world[1] @ matrix(turns[k, 2])]
        b = root[k] + world[0] @ FIELDS["offsets"][1]
        c = b + world[1] @ FIELDS["offsets"][2]
        np.testing.assert_allclose(places[k], [root[k], b, c, root[k] + world[0] @ FIELDS["offsets"][3]], atol=1e-9)
        np.testing.assert_allclose(skeleton.tips(root, turns)[k, 0], c + world[2] @ [0, 0.5, 0], atol=1e-9)
    np.testing.assert_allclose(skeleton.positions(root, skeleton.global_rotations(turns), "global"), places)


def test_positions_need_all_joints():
    skeleton = Skeleton.from_json(FIELDS)
    with pytest.raises(ValueError, match="all 4 joints"):
        skeleton.positions(np.zeros(3), np.zeros((3, 4)))
    assert skeleton.index("c") == 2
    with pytest.raises(KeyError, match="known: a, b, c, d"):
        skeleton.index("e")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"parents": [-1, 0, 3, 0]}, "precede their children"),
        ({"parents": [0, 0, 1, 0]}, "precede their children"),
        ({"parents": [-1, 0]}, "not a skeleton"),
        ({"offsets": [[0, 0, 0]]}, "not a skeleton"),
        ({"offsets": [[0, 0, float("nan")]] * 4}, "finite"),
        ({"tips": [{"parent": 4, "offset": [0, 0, 0]}]}, "tip whose joint"),
        ({"names": [], "parents": [], "offsets": [], "tips": []}, "0 joints"),
        ({"names": None}, "not a skeleton"),
    ],
)
def test_an_invalid_skeleton_is_rejected(change, match):
    with pytest.raises(DecodeError, match=match):
        Skeleton.from_json(FIELDS | change)
