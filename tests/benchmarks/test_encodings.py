"""The comparison of encodings: its encoder against that of the test vectors, its measure against known rotations."""

import math
import struct

import numpy as np
import pytest
from adverb_client.records import decode_q32, decode_q48

from benchmarks.encodings import POINT_M, encode_q32, encode_q48, errors_mm, record_bytes, rows_of, virtual_points
from tests.clients.python import specimen
from verbs import library
from verbs.kernels import quat
from verbs.skeleton import Skeleton


def rotations(*shape: int) -> np.ndarray:
    drawn = np.random.default_rng(7).normal(size=(*shape, 4))
    return drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)


def test_words_are_those_of_the_test_vectors():
    for turn in rotations(300):
        assert encode_q48(turn).tolist() == list(struct.unpack("<HHH", specimen.smallest_three(turn.tolist())))
        assert encode_q32(turn).tolist() == struct.unpack("<I", specimen.smallest_three_32(turn.tolist()))[0]


def test_decoded_rotations_are_within_the_bounds_of_the_specification():
    exact = rotations(5_000)
    for decoded, bound in ((decode_q48(encode_q48(exact)), 1.5e-4), (decode_q32(encode_q32(exact)), 4.8e-3)):
        between = quat.mul(quat.conjugate(exact), decoded)
        angles = 2.0 * np.arcsin(np.linalg.norm(between[..., :3], axis=-1))
        assert 0.1 * bound < angles.max() < bound


def arm() -> Skeleton:
    offsets = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return Skeleton(("root", "middle", "end"), np.array([-1, 0, 1]), offsets)


def test_points_stand_beside_their_joints():
    points = virtual_points(np.tile([0.0, 0.0, 0.0, 1.0], (2, 3, 1)), arm())
    assert points.shape == (2, 3, 3, 3)
    np.testing.assert_allclose(points[1, 2], [0.0, 2.0, 0.0] + POINT_M * np.eye(3), atol=1e-12)


def test_an_error_of_the_root_moves_the_points_of_the_last_joint():
    exact = np.tile([0.0, 0.0, 0.0, 1.0], (1, 3, 1))
    found, angle = exact.copy(), 0.01
    found[:, 0] = [0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)]  # about z
    chord = 2.0 * math.sin(angle / 2)
    arms = [math.hypot(POINT_M, 2.0), 2.0 + POINT_M, 2.0]
    np.testing.assert_allclose(errors_mm(found, exact, arm())[-3:], 1e3 * chord * np.array(arms), rtol=1e-9)


def test_rows_have_bytes_and_errors_of_every_encoding():
    rows = {name: (size, errors) for name, size, errors in rows_of(library.load("arm3"), 500)}
    assert set(rows) == {"f32", "q48", "q32", "weights"}
    assert rows["f32"][1][2] < 1e-3 < rows["q48"][1][2] < rows["q32"][1][2]
    assert all(errors == sorted(errors) for _, errors in rows.values())


@pytest.mark.parametrize(("encoding", "number"), [("f32", 0), ("q48", 1), ("weights", 2), ("q32", 3)])
@pytest.mark.parametrize("joints", [22, 23])
def test_sizes_are_those_of_the_specification(encoding, number, joints):
    assert record_bytes(encoding, joints, joints) == specimen.record_bytes(number, joints)
