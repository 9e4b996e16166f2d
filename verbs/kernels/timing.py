"""Phase ↔ seconds of blends, batched.

Source: ``docs/math.md``, section "Time".
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import pose, timewarp
from verbs.kernels.compile import kernel

__all__ = ["resolve", "velocities"]


@kernel
def resolve(
    weights: F64,
    log_lengths: F64,
    phases: F64,
    looping: bool,
    given_time: bool,
    at: F64,
    phase: F64,
    time_s: F64,
    duration_s: F64,
    rate: F64,
) -> None:
    """Complete phase and time of every batch entry from the one that is given.

    Parameters
    ----------
    weights : (B, N) float64
    log_lengths : (N, M - 1) float64
        Logarithms of the examples' segment lengths in seconds.
    phases : (M,) float64
        Canonical phases of the keytimes.
    looping : bool
        A loop's phase goes on past 1 (1.5 is mid second cycle), another motion's ends hold.
    given_time : bool
        Whether ``at`` holds seconds or phases.
    at : (B,) float64
    phase, time_s, duration_s, rate : (B,) float64
        Written: unwrapped phase, seconds, seconds per cycle, seconds per unit of phase.
    """
    count = phases.shape[0]
    keytimes, tangents = np.empty(count), np.empty(count)
    for b in range(weights.shape[0]):
        timewarp.blend_keytimes(weights[b], log_lengths, keytimes)
        timewarp.slopes(phases, keytimes, looping, tangents)
        duration = keytimes[count - 1]
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
