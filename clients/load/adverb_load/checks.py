"""Checks of decoded pose messages beyond the format: unit rotations, weights that sum to 1, plausible headers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from adverb_client import DecodeError, Layout, PoseMessage
from adverb_client.records import Q32, Q48
from adverb_client.wire import RecordBatch

__all__ = ["check_message"]

LEAST = np.array([0.0, 0.0, 0.0, np.finfo(np.float32).smallest_subnormal], np.float32)
MOST = np.array([1.0, np.inf, np.inf, np.inf], np.float32)
"""Bounds of phase, time, error and duration."""

UNIT = 1e-5
"""Largest deviation of the length of a float32 quaternion from 1."""

SUM = 1e-4
"""Largest deviation of the sum of weights from 1."""

Q48_STEPS, Q32_STEPS = 16_383, 511
"""The largest stored component is twice this number of steps."""

STORED = 2 * (0.75 + 1e-3)
"""Largest sum of squares of the three stored components over steps²: the omitted one is the largest of four."""


def check_message(message: PoseMessage, layouts: Mapping[int, Layout]) -> None:
    """Check all records of a message.

    Raises
    ------
    DecodeError
        If a number is not plausible; the text names the first one.
    """
    for batch in message.batches:
        _check_headers(batch)
        if batch.weights is not None:
            _check_weights(batch, layouts)
        elif batch.headers["encoding"][0] == Q48:
            _check_q48(batch)
        elif batch.headers["encoding"][0] == Q32:
            _check_q32(batch)
        else:
            _check_rotations(batch)


def _check_headers(batch: RecordBatch) -> None:
    numbers = batch.headers["floats"][:, :4]
    bad = (numbers < LEAST) | (numbers > MOST)  # the error may be NaN
    if bad.any():
        row = batch.headers[int(np.argmax(bad.any(axis=1)))]
        raise DecodeError(
            f"phase {row['phase']}, time {row['time']} s, error {row['error']}, duration {row['duration']} s "
            f"on channel {row['channel']}"
        )


def _check_rotations(batch: RecordBatch) -> None:
    assert batch.rotations is not None
    squares = np.einsum("rjk,rjk->rj", batch.rotations, batch.rotations)
    if squares.size and (squares.max() > 1.0 + 2.0 * UNIT or squares.min() < 1.0 - 2.0 * UNIT):
        raise DecodeError(f"quaternions of length {np.sqrt(squares.min())} to {np.sqrt(squares.max())}")


def _check_q48(batch: RecordBatch) -> None:
    words = batch.headers["words"]
    if words[..., 2].max(initial=0) > 2 * Q48_STEPS:  # bit 15 of the third word is 0
        raise DecodeError("q48 words out of range")
    _check_smallest_three(words & 0x7FFF, Q48_STEPS, tolerance=0.0)


def _check_q32(batch: RecordBatch) -> None:
    parts = batch.headers["words"][..., None] >> np.array([0, 10, 20], np.uint32) & 0x3FF
    _check_smallest_three(parts, Q32_STEPS, tolerance=2.0 / Q32_STEPS)


def _check_smallest_three(words: npt.NDArray[Any], steps: int, *, tolerance: float) -> None:
    """Check stored components (R, J, 3); rounding changes sums of squares by the tolerance."""
    if not words.size:
        return
    if words.max() > 2 * steps:
        raise DecodeError("stored components of rotations out of range")
    stored = (words.astype(np.float32) - steps) / steps
    if np.einsum("rjk,rjk->rj", stored, stored).max() > STORED + tolerance:
        raise DecodeError("a rotation whose omitted component is not the largest")


def _check_weights(batch: RecordBatch, layouts: Mapping[int, Layout]) -> None:
    weights = batch.weights
    assert weights is not None
    counts = {layouts[channel].count for channel in batch.headers["channel"].tolist()}
    if counts != {weights.shape[1]} or any(batch.headers["zero"].tolist()):
        raise DecodeError(f"{weights.shape[1]} weights in records of {sorted(counts)}")
    sums = weights.sum(axis=1).tolist()
    if not 1.0 - SUM < min(sums) <= max(sums) < 1.0 + SUM:
        raise DecodeError(f"weights that sum to {min(sums)} to {max(sums)}")
