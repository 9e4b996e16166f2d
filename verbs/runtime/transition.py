"""Transitions between verbs: skeleton check, start phase and root position of the next verb.

The offsets of joints are in :mod:`verbs.kernels.inertialization`.
"""

from __future__ import annotations

import math

import numpy as np

from verbs.conventions import F64
from verbs.errors import SkeletonMismatch
from verbs.verb import Verb

__all__ = ["aligned", "check_skeletons", "heading", "start_phase"]


def check_skeletons(source: Verb, target: Verb) -> None:
    """Raise :class:`SkeletonMismatch` unless both verbs move the same joints; their lengths may differ."""
    problem = source.skeleton.difference(target.skeleton, tolerance_m=math.inf)
    if problem:
        raise SkeletonMismatch(
            f"verb '{target.name}' moves another skeleton than '{source.name}': it {problem}; "
            "open another channel for it"
        )


def start_phase(source: Verb, phase: float, target: Verb, *, speed: float = 1.0) -> float:
    """Phase at which a target continues from a source's phase.

    Where both loop and name the same keytimes, phases between these correspond: left stance to left stance. Otherwise
    the target starts at its start, or at its end if it is played backwards.
    """
    if source.looping and target.looping:
        ours, theirs = (
            dict(zip(verb.keytime_names[:-1], verb.phases.tolist(), strict=False)) for verb in (source, target)
        )
        shared = [name for name in ours if name in theirs]
        if shared:
            return _corresponding(phase, np.array([(ours[name], theirs[name]) for name in shared]))
    return 1.0 if speed < 0 else 0.0


def _corresponding(phase: float, pairs: F64) -> float:
    """Phase (0 to 1) that corresponds on the second circle, given pairs (P, 2) that rise on the first."""
    steps = np.diff(np.append(pairs[:, 1], pairs[0, 1])) % 1.0
    steps[steps == 0.0] = 1.0  # one pair alone is a whole cycle away from itself
    if steps.sum() > 1.5:  # their order differs: only the first one counts
        pairs, steps = pairs[:1], np.ones(1)
    firsts = np.append(pairs[:, 0], pairs[0, 0] + 1.0)
    seconds = pairs[0, 1] + np.append(0.0, np.cumsum(steps))
    at = phase if phase >= firsts[0] else phase + 1.0
    return float(np.interp(at, firsts, seconds)) % 1.0


def heading(rotation: F64) -> float:
    """Heading (rad), about +Y, of a root rotation (4,)."""
    return 2.0 * math.atan2(float(rotation[1]), float(rotation[3]))


def aligned(at: tuple[float, float, float], frame: F64) -> tuple[float, float, float]:
    """Position (x, z, heading) of a motion whose first frame, root (x, z, heading), is to be at ``at``."""
    turn = at[2] - frame[2]
    cosine, sine = math.cos(turn), math.sin(turn)
    return (
        at[0] - (frame[0] * cosine + frame[1] * sine),
        at[1] - (-frame[0] * sine + frame[1] * cosine),
        math.remainder(turn, 2.0 * math.pi),
    )
