"""One pose in one call: phase or seconds, then the blend at that phase.

Calls of compiled code and arrays cost as much as the arithmetic of a single pose; batches have kernels of their own.

Source: ``docs/math.md``, sections "Time" and "Poses".
"""

from __future__ import annotations

from verbs.conventions import F64
from verbs.kernels import timing
from verbs.kernels.compile import kernel
from verbs.kernels.crowd_pose import Curves, blend_sorted
from verbs.kernels.timewarp import Clock
from verbs.kernels.timing import Instants

__all__ = ["single_pose"]


@kernel
def single_pose(
    weights: F64, clock: Clock, at: F64, given_time: bool, curves: Curves, found: Instants, root: F64, rotations: F64
) -> None:
    """Pose of weights (1, N) at a phase, or (``given_time``) at seconds (1,).

    Parameters
    ----------
    found : Instants
        Written; see :func:`verbs.kernels.timing.resolve`.
    root, rotations : (1, 3), (1, J, 4) float64
        Written; see :func:`verbs.kernels.crowd_pose.blend_sorted`.
    """
    timing.resolve(weights, clock, at, given_time, found)
    at[0] = found.phase[0] % 1.0 if clock.looping else found.phase[0]
    blend_sorted(weights, at, curves, root, rotations)
