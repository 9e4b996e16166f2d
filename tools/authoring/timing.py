"""Timing functions: minimum-jerk ease, eases within a window, and bumps."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, Floats

__all__ = ["bump", "ease", "there_and_back"]


def ease(times: Floats, start: float = 0.0, end: float = 1.0) -> F64:
    """Go from 0 at ``start`` to 1 at ``end`` with the least jerk: no speed or acceleration at either end.

    Source: T. Flash, N. Hogan, "The Coordination of Arm Movements", 1985, equation 3.
    """
    t = np.clip((np.asarray(times, np.float64) - start) / (end - start), 0.0, 1.0)
    return np.asarray(t * t * t * (10.0 + t * (6.0 * t - 15.0)))


def bump(progress: Floats) -> F64:
    """Rise from 0 to 1 and fall back, as ``progress`` goes from 0 to 1; flat at both ends."""
    progress = np.asarray(progress, np.float64)
    return np.asarray(16.0 * (progress * (1.0 - progress)) ** 2)


def there_and_back(phases: Floats, out: tuple[float, float], back: tuple[float, float]) -> F64:
    """Progress toward the apex: 0 at phase 0, 1 at phase 1, 0 again at phase 2.

    Parameters
    ----------
    phases : (F,)
        0 at the start, 1 at the apex, 2 at the end.
    out, back : (float, float)
        When in the way out, and in the way back, this part of the body moves; each within 0-1.

    Returns
    -------
    progress : (F,) float64
    """
    phases = np.asarray(phases, np.float64)
    return np.where(phases <= 1.0, ease(phases, *out), 1.0 - ease(phases - 1.0, *back))
