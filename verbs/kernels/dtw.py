"""Dynamic time warping of two feature sequences inside a band about the diagonal.

Source: H. Sakoe, S. Chiba, "Dynamic programming algorithm optimization for spoken word recognition", IEEE Transactions
on Acoustics, Speech, and Signal Processing 26, 1978: symmetric steps; a step along one axis only costs a penalty.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["warp"]

I8 = npt.NDArray[np.int8]

BOTH, FIRST, SECOND = 0, 1, 2
"""Steps: both sequences advance, the first alone, the second alone."""


@kernel
def _distance(first: F64, second: F64) -> float:
    """Euclidean distance of two feature vectors."""
    total = 0.0
    for d in range(first.shape[0]):
        total += (first[d] - second[d]) ** 2
    return np.sqrt(total)


@kernel
def _fill(first: F64, second: F64, half: int, penalty: float, steps: I8) -> float:
    """Least cost from the first pair of frames to the last; ``steps`` (A, 2·half + 1) is written."""
    rows, columns = first.shape[0], second.shape[0]
    width = 2 * half + 1
    before, now = np.full(width + 1, np.inf), np.full(width + 1, np.inf)
    low_before = 0
    slope = (columns - 1) / max(rows - 1, 1)
    for i in range(rows):
        low = int(np.floor(i * slope + 0.5)) - half
        shift = low - low_before
        now[:] = np.inf
        for c in range(width):
            j = low + c
            if j < 0 or j >= columns:
                continue
            here = _distance(first[i], second[j])
            if i == 0 and j == 0:
                now[c] = here
                continue
            best, step = np.inf, BOTH
            diagonal, above = c - 1 + shift, c + shift
            if i > 0 and 0 <= diagonal < width and before[diagonal] < best:
                best, step = before[diagonal], BOTH
            if i > 0 and 0 <= above < width and before[above] + penalty < best:
                best, step = before[above] + penalty, FIRST
            if c > 0 and now[c - 1] + penalty < best:
                best, step = now[c - 1] + penalty, SECOND
            now[c], steps[i, c] = best + here, step
        before, now = now, before
        low_before = low
    return before[columns - 1 - low_before]


@kernel
def warp(first: F64, second: F64, half: int, penalty: float, path: I64) -> tuple[float, int]:
    """Align two sequences.

    Parameters
    ----------
    first, second : (A, D), (B, D) float64
        Features of frames.
    half : int
        Half of the band's width, frames of the second; at least the slope B / A, so that the band is connected.
    penalty : float
        Added for each step that advances one sequence alone.
    path : (A + B, 2) int64
        Written: frames that belong together, from the last pair to the first.

    Returns
    -------
    cost : float
        Sum of distances and penalties along the path; infinite where the band is not connected.
    length : int
        Pairs in the path.
    """
    rows, columns = first.shape[0], second.shape[0]
    steps = np.zeros((rows, 2 * half + 1), np.int8)
    cost = _fill(first, second, half, penalty, steps)
    slope = (columns - 1) / max(rows - 1, 1)
    i, j, length = rows - 1, columns - 1, 0
    if not np.isfinite(cost):
        return cost, 0
    while True:
        path[length, 0], path[length, 1] = i, j
        length += 1
        if i == 0 and j == 0:
            return cost, length
        step = steps[i, j - (int(np.floor(i * slope + 0.5)) - half)]
        i -= step != SECOND
        j -= step != FIRST
