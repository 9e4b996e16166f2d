"""Checks of decoded pose messages beyond the format: unit rotations, weights that sum to 1, plausible headers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from adverb_client import DecodeError, Layout, PoseMessage
from adverb_client.records import Q48
from adverb_client.wire import RecordBatch

__all__ = ["check_message"]

LEAST = np.array([0.0, 0.0, 0.0, np.finfo(np.float32).smallest_subnormal], np.float32)
MOST = np.array([1.0, np.inf, np.inf, np.inf], np.float32)
"""Bounds of phase, time, error and duration."""

UNIT = 1e-5
"""Largest deviation of the length of a float32 quaternion from 1."""

SUM = 1e-4
"""Largest deviation of the sum of weights from 1."""

STEPS = 16_383
LARGEST = 2 * STEPS
"""Largest word of q48, without its bit 15."""

STORED = 2 * STEPS**2 * (0.75 + 1e-3)
"""Largest sum of squares of the three stored components, in steps: the omitted one is the largest of four."""


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
            _check_words(batch)
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


def _check_words(batch: RecordBatch) -> None:
    words = batch.headers["words"]
    low = words & 0x7FFF
    if not low.size:
        return
    if max(low.max(), words[..., 2].max()) > LARGEST:  # bit 15 of the third word is 0
        raise DecodeError("q48 words out of range")
    stored = low.astype(np.float32) - STEPS
    if np.einsum("rjk,rjk->rj", stored, stored).max() > STORED:
        raise DecodeError("a q48 rotation whose omitted component is not the largest")


def _check_weights(batch: RecordBatch, layouts: Mapping[int, Layout]) -> None:
    weights = batch.weights
    assert weights is not None
    counts = {layouts[channel].count for channel in batch.headers["channel"].tolist()}
    if counts != {weights.shape[1]} or any(batch.headers["zero"].tolist()):
        raise DecodeError(f"{weights.shape[1]} weights in records of {sorted(counts)}")
    sums = weights.sum(axis=1).tolist()
    if not 1.0 - SUM < min(sums) <= max(sums) < 1.0 + SUM:
        raise DecodeError(f"weights that sum to {min(sums)} to {max(sums)}")
