"""Phase ↔ seconds of blends, and root velocities, batched.

Source: ``docs/math.md``, section "Time".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels import pose, timewarp
from verbs.kernels.compile import kernel
from verbs.kernels.timewarp import Clock

__all__ = ["Instants", "instants", "resolve", "velocities"]


class Instants(NamedTuple):
    """Instants of B motions.

    Parameters
    ----------
    phase, time_s : (B,) float64
        Unwrapped phase, beyond 1 in further cycles of a loop; seconds since the start.
    duration_s, rate : (B,) float64
        Seconds per cycle, and seconds per unit of phase there.
    """

    phase: F64
    time_s: F64
    duration_s: F64
    rate: F64


def instants(size: int) -> Instants:
    """Empty arrays for so many motions."""
    return Instants(*np.empty((4, size)))


@kernel
def resolve(weights: F64, clock: Clock, at: F64, given_time: bool, out: Instants) -> None:
    """Complete phase and time of every batch entry from the one that is given.

    Parameters
    ----------
    weights : (B, N) float64
    clock : Clock
    at : (B,) float64
        Seconds or phases; outside a motion that does not loop, its ends count.
    given_time : bool
        Whether ``at`` contains seconds or phases.
    out : Instants
        Written.
    """
    phases, log_lengths, looping = clock
    phase, time_s, duration_s, rate = out
    keytimes, tangents = np.empty(phases.shape[0]), np.empty(phases.shape[0])
    for b in range(weights.shape[0]):
        timewarp.blend_keytimes(weights[b], log_lengths, keytimes)
        timewarp.slopes(phases, keytimes, looping, tangents)
        duration = keytimes[phases.shape[0] - 1]
        whole = duration if given_time else 1.0
        cycles = np.floor(at[b] / whole) if looping else 0.0
        rest = min(max(at[b] - cycles * whole, 0.0), whole)
        if given_time:
            local = timewarp.phase_at(phases, keytimes, tangents, rest)
            seconds = rest
        else:
            local = rest
            seconds = timewarp.time_at(phases, keytimes, tangents, rest)
        phase[b], time_s[b], duration_s[b] = local + cycles, seconds + cycles * duration, duration
        rate[b] = timewarp.rate_at(phases, keytimes, tangents, local)


@kernel
def velocities(weights: F64, strides: F64, phase: F64, rate: F64, looping: bool, out: F64) -> None:
    """Root velocities (B, 3) of a striding verb: sideways, forward (m/s), turn (rad/s), in the heading's frame."""
    for b in range(weights.shape[0]):
        pose.velocity(weights[b], strides, phase[b] % 1.0 if looping else phase[b], rate[b], looping, out[b])
