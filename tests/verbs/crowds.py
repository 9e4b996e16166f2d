"""Columns of characters for tests of kernels."""

from __future__ import annotations

import numpy as np

from verbs.kernels import character_state
from verbs.kernels.character_state import Crowd
from verbs.kernels.foot_state import FOOT
from verbs.kernels.legs import COMMAND, Legs

NO_LEGS = Legs(
    np.zeros((0, 4), np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((0, 3)),
    np.zeros((1, 3)),
)  # fmt: skip


def crowd_of(count, *, dims=1, examples=1, keytimes=3):
    """Characters that are known and have no stored frames; everything else is zero."""
    state = np.zeros(count, character_state.CHARACTER)
    state["held"] = -1
    points, times, ends = np.zeros((5, count, dims)), np.zeros((2, count, keytimes)), np.zeros((2, count))
    known, weights = np.ones(count, np.int64), np.zeros((count, 3, examples))
    feet = np.zeros((count, 0), FOOT), np.zeros((count, 2, 0, len(COMMAND)))
    return Crowd(state, known, *points, weights, *times, np.zeros((count, 0)), *ends, *feet)
