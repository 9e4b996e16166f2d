"""Axes and rotations of the Blender add-on, compared with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from adverb_blender import coordinates
from scipy.spatial.transform import Rotation

ROTATIONS = [*Rotation.random(20, rng=3).as_quat(), (0.0, 0.0, 0.0, 1.0)]


def test_axes_are_those_of_blender_and_back():
    assert coordinates.to_blender((1.0, 2.0, 3.0)) == (1.0, -3.0, 2.0), (
        "+Y is up, +Z is forward, which is −Y in Blender"
    )
    assert coordinates.from_blender(coordinates.to_blender((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_rotations_commute_with_axes(rotation):
    point = (0.3, -1.2, 0.5)
    rotated = coordinates.rotate(rotation, point)
    np.testing.assert_allclose(rotated, Rotation.from_quat(rotation).apply(point), atol=1e-12)
    same = coordinates.rotate(coordinates.rotation_to_blender(rotation), coordinates.to_blender(point))
    np.testing.assert_allclose(same, coordinates.to_blender(rotated), atol=1e-12)
    np.testing.assert_allclose(coordinates.rotation_from_blender(coordinates.rotation_to_blender(rotation)), rotation)


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_products_and_inverses(rotation):
    other = ROTATIONS[3]
    expected = (Rotation.from_quat(rotation) * Rotation.from_quat(other)).as_matrix()
    np.testing.assert_allclose(
        Rotation.from_quat(coordinates.multiply(rotation, other)).as_matrix(), expected, atol=1e-12
    )
    np.testing.assert_allclose(
        coordinates.multiply(rotation, coordinates.conjugate(rotation)), (0.0, 0.0, 0.0, 1.0), atol=1e-12
    )


@pytest.mark.parametrize(
    "rotation", [*ROTATIONS, *Rotation.from_euler("ZXY", [[30, 90, 0], [200, -90, 0]], True).as_quat()]
)
def test_angles_of_bvh_give_the_rotation(rotation):
    found = Rotation.from_euler("ZXY", coordinates.zxy(rotation), degrees=True)
    np.testing.assert_allclose(found.as_matrix(), Rotation.from_quat(rotation).as_matrix(), atol=1e-7)
