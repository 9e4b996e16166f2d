"""Many poses at one phase, in single precision: a matrix product, normalised rotations, joint positions.

Characters that share a phase differ in their weights only, so that blending them is one matrix product. Characters
come last, in tiles of :data:`TILE` (structure of arrays); a tile stays in the cache from the product to the last
joint. Each step is a function of its own, on arrays without gaps: compiled as one loop, or on parts of longer rows,
they do not vectorise.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F32, I64
from verbs.kernels.compile import kernel

__all__ = ["TILE", "crowd"]

TILE = 128
"""Characters that go through all steps together."""

SHORTEST_SQUARED = np.float32(0.3 * 0.3)
"""Squared length under which a sum has lost its direction, as in :func:`verbs.kernels.pose.finish_rotation`."""

ONE = np.float32(1.0)


@kernel
def _normalise(sums: F32, reference: F32, out: F32) -> None:
    """Unit quaternions (4, T) of sums (4, T); where a sum is too short, the reference (4,)."""
    a, b, c, d = reference[0], reference[1], reference[2], reference[3]
    for k in range(sums.shape[1]):
        x, y, z, w = sums[0, k], sums[1, k], sums[2, k], sums[3, k]
        squared = x * x + y * y + z * z + w * w
        short = squared < SHORTEST_SQUARED
        scale = ONE / np.sqrt(squared)
        out[0, k] = a if short else scale * x
        out[1, k] = b if short else scale * y
        out[2, k] = c if short else scale * z
        out[3, k] = d if short else scale * w


@kernel
def _global_rotation(parent: F32, local: F32, out: F32) -> None:
    """Global rotations (4, T) of a joint from its parent's (4, T) and its local ones (4, T)."""
    for k in range(parent.shape[1]):
        x, y, z, w = parent[0, k], parent[1, k], parent[2, k], parent[3, k]
        a, b, c, d = local[0, k], local[1, k], local[2, k], local[3, k]
        out[0, k] = w * a + x * d + y * c - z * b
        out[1, k] = w * b - x * c + y * d + z * a
        out[2, k] = w * c + x * b - y * a + z * d
        out[3, k] = w * d - x * a - y * b - z * c


@kernel
def _position(parent: F32, rotation: F32, offset: F32, out: F32) -> None:
    """Positions (3, T) of a joint: its parent's (3, T) plus the offset (3,), rotated as the parent is (4, T)."""
    a, b, c = offset[0], offset[1], offset[2]
    for k in range(parent.shape[1]):
        x, y, z, w = rotation[0, k], rotation[1, k], rotation[2, k], rotation[3, k]
        s, t, u = y * c - z * b, z * a - x * c, x * b - y * a
        s, t, u = s + s, t + t, u + u
        out[0, k] = parent[0, k] + a + w * s + y * u - z * t
        out[1, k] = parent[1, k] + b + w * t + z * s - x * u
        out[2, k] = parent[2, k] + c + w * u + x * t - y * s


@kernel
def crowd(
    weights: F32, rows: F32, references: F32, parents: I64, offsets: F32, out_rotations: F32, out_positions: F32
) -> None:
    """Pose B characters at one phase; character b is the last axis' b % TILE of tile b // TILE.

    Parameters
    ----------
    weights : (B, N) float32
        Weights of the examples; each row sums to 1.
    rows : (N, 4 + 4·J) float32
        The examples at the phase: root position and a zero, then a quaternion per joint, aligned in sign.
    references : (J, 4) float32
        Rotation of each joint where the examples cancel.
    parents : (J,) int64
        Parent of each joint, standing before it.
    offsets : (J, 3) float32
        Position of each joint in its parent's frame, metres; the root's is not used.
    out_rotations : (⌈B / TILE⌉, J, 4, TILE) float32
        Written: local rotations, unit quaternions. Entries past B are a pose without meaning.
    out_positions : (⌈B / TILE⌉, J, 3, TILE) float32
        Written: joint positions, metres.
    """
    batch, joints = weights.shape[0], parents.shape[0]
    columns = np.ascontiguousarray(rows.T)
    sums = np.empty((rows.shape[1], TILE), np.float32)
    global_rotations = np.empty((joints, 4, TILE), np.float32)
    for tile in range(out_rotations.shape[0]):
        tile_weights = weights[tile * TILE : (tile + 1) * TILE]
        if tile_weights.shape[0] < TILE:
            tile_weights = np.zeros((TILE, weights.shape[1]), np.float32)
            tile_weights[: batch - tile * TILE] = weights[tile * TILE :]
        np.dot(columns, tile_weights.T, sums)
        rotations, positions = out_rotations[tile], out_positions[tile]
        for j in range(joints):
            _normalise(sums[4 + 4 * j : 8 + 4 * j], references[j], rotations[j])
            if j == 0:
                global_rotations[0], positions[0] = rotations[0], sums[:3]
            else:
                i = parents[j]
                _global_rotation(global_rotations[i], rotations[j], global_rotations[j])
                _position(positions[i], global_rotations[i], offsets[j], positions[j])
