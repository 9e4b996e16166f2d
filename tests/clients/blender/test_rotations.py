"""Axes and rotations of the Blender add-on, compared with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from adverb_blender import rotations
from scipy.spatial.transform import Rotation

TURNS = [*Rotation.random(20, rng=3).as_quat(), (0.0, 0.0, 0.0, 1.0)]


def test_axes_are_those_of_blender_and_back():
    assert rotations.to_blender((1.0, 2.0, 3.0)) == (1.0, -3.0, 2.0), "+Y is up, +Z is forward, which is −Y in Blender"
    assert rotations.from_blender(rotations.to_blender((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("turn", TURNS)
def test_rotations_commute_with_axes(turn):
    point = (0.3, -1.2, 0.5)
    rotated = rotations.rotate(turn, point)
    np.testing.assert_allclose(rotated, Rotation.from_quat(turn).apply(point), atol=1e-12)
    same = rotations.rotate(rotations.turn_to_blender(turn), rotations.to_blender(point))
    np.testing.assert_allclose(same, rotations.to_blender(rotated), atol=1e-12)
    np.testing.assert_allclose(rotations.turn_from_blender(rotations.turn_to_blender(turn)), turn)


@pytest.mark.parametrize("turn", TURNS)
def test_products_and_inverses(turn):
    other = TURNS[3]
    expected = (Rotation.from_quat(turn) * Rotation.from_quat(other)).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(rotations.multiply(turn, other)).as_matrix(), expected, atol=1e-12)
    np.testing.assert_allclose(rotations.multiply(turn, rotations.conjugate(turn)), (0.0, 0.0, 0.0, 1.0), atol=1e-12)


@pytest.mark.parametrize("turn", [*TURNS, *Rotation.from_euler("ZXY", [[30, 90, 0], [200, -90, 0]], True).as_quat()])
def test_angles_of_bvh_give_the_rotation(turn):
    found = Rotation.from_euler("ZXY", rotations.zxy(turn), degrees=True)
    np.testing.assert_allclose(found.as_matrix(), Rotation.from_quat(turn).as_matrix(), atol=1e-7)
