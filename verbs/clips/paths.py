"""Rotation paths over time: angles between frames, interpolation across a stretch, runs of frames."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from verbs.conventions import F64, I64, Floats
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["angles", "bridge", "frame_range", "positions", "replaced", "runs", "slerp", "steps", "with_joint"]

Flags = npt.NDArray[np.bool_]

NEIGHBOURS = 3
"""Frames on each side of a stretch through which its interpolation passes."""


def angles(left: Floats, right: Floats) -> F64:
    """Angles (...), radians, 0 to π, between unit quaternions (..., 4) as rotations."""
    apart = quat.mul(quat.conjugate(left), right)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(apart[..., :3], axis=-1), np.abs(apart[..., 3])))


def steps(rotations: Floats) -> F64:
    """Angles (F - 1, ...) between successive frames of rotations (F, ..., 4), radians."""
    rotations = np.asarray(rotations, np.float64)
    return angles(rotations[:-1], rotations[1:])


def slerp(first: Floats, last: Floats, shares: Floats) -> F64:
    """Rotations (S, 4) at shares (S,) of the shorter way from one unit quaternion (4,) to another."""
    turn = quat.log(quat.mul(quat.conjugate(first), last))
    return quat.mul(first, quat.exp(np.asarray(shares)[:, None] * turn))


def bridge(values: F64, first: int, last: int) -> F64:
    """Values (F, C) in which frames ``first`` to ``last`` are interpolated from their neighbours.

    Parameters
    ----------
    values : (F, C) float64
        Positions, or quaternions of one joint in one hemisphere around the stretch.
    first, last : int
        First and last frame that are replaced, both included.

    Returns
    -------
    values : (F, C) float64
        A cubic spline through three frames on each side; of fewer frames, a polynomial of lower degree; the nearest
        frame where one side is missing.
    """
    before = np.arange(max(first - NEIGHBOURS, 0), first)
    after = np.arange(last + 1, min(last + 1 + NEIGHBOURS, len(values)))
    out = values.copy()
    inner = np.arange(first, last + 1)
    if not len(before) or not len(after):
        kept = np.concatenate([before[-1:], after[:1]])
        out[inner] = values[kept] if len(kept) else values[inner]
        return out
    known = np.concatenate([before, after])
    out[inner] = CubicSpline(known, values[known])(inner) if len(known) > 2 else _line(values, known, inner)
    return out


def _line(values: F64, known: I64, inner: I64) -> F64:
    share = ((inner - known[0]) / (known[1] - known[0]))[:, None]
    return np.asarray(values[known[0]] + share * (values[known[1]] - values[known[0]]))


def replaced(rotations: F64, first: int, last: int) -> F64:
    """Rotations (F, 4) of one joint in which frames ``first`` to ``last`` are interpolated from their neighbours."""
    before, after = max(first - NEIGHBOURS, 0), min(last + 1 + NEIGHBOURS, len(rotations))
    known = np.concatenate([np.arange(before, first), np.arange(last + 1, after)])
    smooth = rotations.copy()
    smooth[known] = quat.unroll(rotations[known])
    out = rotations.copy()
    out[first : last + 1] = quat.normalize(bridge(smooth, first, last)[first : last + 1])
    return out


def runs(flags: Flags) -> I64:
    """First frames, and frames after the last, (R, 2) of the runs in which flags (F,) are set."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int64), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def positions(motion: Motion) -> F64:
    """Positions (F, J, 3) of all joints, metres."""
    skeleton = motion.skeleton
    return fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)[1]


def with_joint(motion: Motion, joint: int, rotations: F64, root: F64 | None = None) -> Motion:
    """A motion with other rotations (F, 4) of one joint, and another path (F, 3) of the root where that is given."""
    turned = motion.rotations.copy()
    turned[:, joint] = rotations
    return Motion(motion.skeleton, motion.fps, motion.root if root is None else root, turned)


def frame_range(motion: Motion, start_s: float | None, end_s: float | None) -> tuple[int, int]:
    """First and last frame, both included, of a stretch in seconds; an end that is None is that of the motion."""
    last = len(motion) - 1
    first = 0 if start_s is None else round(start_s * motion.fps)
    final = last if end_s is None else round(end_s * motion.fps)
    return min(max(first, 0), last), min(max(final, 0), last)
