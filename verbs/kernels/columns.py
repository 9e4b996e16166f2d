"""Batches as tiles of columns: characters last (structure of arrays), so that loops over characters vectorise."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["BATCH", "gather", "product", "put", "scatter", "take", "tiles"]

BATCH = 10
"""From so many rows on a tile takes less time than rows one by one."""

TILE = 256
"""Most characters that go through all steps together."""

LANES = 16
"""Tiles are whole multiples of this, so that loops vectorise."""


@kernel
def tiles(batch: int) -> tuple[int, int]:
    """Number of tiles for a batch, and their width: whole lanes, as even as possible."""
    count = max((batch + TILE - 1) // TILE, 1)
    each = (batch + count - 1) // count
    return count, max((each + LANES - 1) // LANES, 1) * LANES


@kernel
def gather(rows: F64, first: int, out: F64) -> None:
    """Columns (A, T) from rows (B, A) from ``first`` on; past the end the last row is repeated."""
    last = rows.shape[0] - 1
    for k in range(out.shape[1]):
        b = min(first + k, last)
        for a in range(out.shape[0]):
            out[a, k] = rows[b, a]


@kernel
def scatter(columns: F64, first: int, out: F64) -> None:
    """Write columns (A, T) to rows (B, A) from ``first`` on; columns past the end are left out."""
    for k in range(min(columns.shape[1], out.shape[0] - first)):
        for a in range(columns.shape[0]):
            out[first + k, a] = columns[a, k]


@kernel
def take(columns: F64, origins: I64, out: F64) -> None:
    """Some columns of an array (A, T), to the first of ``out`` (A, t); the last one is repeated until it is full."""
    last = origins.shape[0] - 1
    for a in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[a, k] = columns[a, origins[min(k, last)]]


@kernel
def put(columns: F64, origins: I64, out: F64) -> None:
    """Write columns (A, t) back to where :func:`take` has them from."""
    for a in range(out.shape[0]):
        for k in range(origins.shape[0]):
            out[a, origins[k]] = columns[a, k]


@kernel
def product(columns: F64, matrix: F64, scratch: F64, first: int, out: F64) -> None:
    """Columns (A, T), transposed, times a matrix (A, N), to the rows of ``out`` (B, N) from ``first`` on.

    What is past the end is left out; the product then takes ``scratch`` (T, N).
    """
    end = first + scratch.shape[0]
    if end <= out.shape[0]:
        np.dot(columns.T, matrix, out[first:end])
    else:
        np.dot(columns.T, matrix, scratch)
        out[first:] = scratch[: out.shape[0] - first]
