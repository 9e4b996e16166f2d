from __future__ import annotations

import numpy as np
import pytest

from verbs.kernels import crowd as kernels
from verbs.kernels import fk, pose

EXAMPLES, JOINTS = 5, 8
TILE = kernels.TILE


def some_examples(joints: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows (N, 4 + 4·J), references (J, 4), parents and offsets of examples not far from each other."""
    rng = np.random.default_rng(seed)
    references = rng.normal(size=(joints, 4))
    references /= np.linalg.norm(references, axis=1, keepdims=True)
    turns = references + 0.2 * rng.normal(size=(EXAMPLES, joints, 4))
    rows = np.zeros((EXAMPLES, 4 + 4 * joints), np.float32)
    rows[:, :3] = rng.normal(size=(EXAMPLES, 3))
    rows[:, 4:] = turns.reshape(EXAMPLES, -1) / np.linalg.norm(turns, axis=2).repeat(4, axis=1)
    parents = np.array([-1, *(rng.integers(0, j) for j in range(1, joints))], np.int64)
    return rows, references, parents, 0.3 * rng.normal(size=(joints, 3))


def in_crowd(weights, rows, references, parents, offsets) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (B, J, 4) and positions (B, J, 3) by the kernel under test."""
    tiles, joints = -(-len(weights) // TILE), len(parents)
    rotations = np.full((tiles, joints, 4, TILE), np.nan, np.float32)
    places = np.full((tiles, joints, 3, TILE), np.nan, np.float32)
    single = [np.asarray(a, np.float32) for a in (weights, rows, references, offsets)]
    kernels.crowd(*single[:3], parents, single[3], rotations, places)
    return _characters_first(rotations)[: len(weights)], _characters_first(places)[: len(weights)]


def _characters_first(tiled: np.ndarray) -> np.ndarray:
    tiles, joints, width, size = tiled.shape
    return tiled.transpose(0, 3, 1, 2).reshape(tiles * size, joints, width)


def one_by_one(weights, rows, references, parents, offsets) -> tuple[np.ndarray, np.ndarray]:
    """The same in double precision, by the kernels that pose single characters."""
    batch, joints = len(weights), len(parents)
    root, rotations = np.empty((batch, 3)), np.empty((batch, joints, 4))
    curves = np.ascontiguousarray(np.broadcast_to(rows, (4, *rows.shape)))  # the same row at every phase
    pose.blend(weights, np.full(batch, 0.5), curves, pose.NLERP, references, root, rotations)
    return rotations, fk.forward(root, rotations, parents, offsets)[1]


@pytest.mark.parametrize("batch", [1, 7, TILE - 1, TILE, TILE + 1, 2 * TILE + 44])
@pytest.mark.parametrize("joints", [1, JOINTS])
def test_a_crowd_stands_as_each_character_alone(batch, joints):
    examples = some_examples(joints)
    weights = np.random.default_rng(1).dirichlet(np.ones(EXAMPLES), batch) * 1.4 - 0.4 / EXAMPLES  # some below 0
    rotations, places = in_crowd(weights, *examples)
    expected_rotations, expected_places = one_by_one(weights, *examples)
    np.testing.assert_allclose(rotations, expected_rotations, atol=1e-5)  # single precision
    np.testing.assert_allclose(places, expected_places, atol=1e-5)


def test_examples_that_cancel_give_the_reference():
    rows, references, parents, offsets = some_examples(JOINTS)
    rows[1, 4:] = -rows[0, 4:]
    weights = np.zeros((3, EXAMPLES))
    weights[:, :2] = 0.5
    rotations, places = in_crowd(weights, rows, references, parents, offsets)
    np.testing.assert_allclose(rotations, np.broadcast_to(references, rotations.shape), atol=1e-6)
    assert np.isfinite(places).all()


def test_no_characters_are_no_work():
    rotations, places = in_crowd(np.zeros((0, EXAMPLES)), *some_examples(JOINTS))
    assert rotations.size == places.size == 0
