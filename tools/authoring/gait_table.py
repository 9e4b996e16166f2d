"""Walks and runs at any speed: parameters that were fitted to published curves, and what the upper body does.

The numbers are printed by ``python -m tools.authoring.gait_fit``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from tools.authoring.gait_fit import NAMES, run_start, walk_start
from tools.authoring.gait_model import Gait

__all__ = ["FITTED_RUNS", "FITTED_WALKS", "run", "walk"]

# speed, m/s: values of gait_fit.NAMES, then the bend of the straightest knee.
# fmt: off
FITTED_WALKS: dict[float, tuple[float, ...]] = {
    0.5: (
        -0.05744, 6.723, 0.07846, 0.4052, -40.3, -54.28, -26.75, -1.249, 13.68, 0.01413, -0.03223,
        0.03629, 0.007093, 0.004433, 0.2573, 0.01839, 0.0534, 4.064, 1.077, 0.1694, 1.456, 4,
    ),
    0.9: (
        -0.06927, 9.862, 0.07048, 0.4022, -48.02, -61.19, -31.59, -0.4654, 19.8, 0.03585, -0.03554,
        0.09312, -0.02518, 0.01247, 0.2598, 0.02303, -0.01377, 4.381, 1.781, 0.1928, 4.768, 4,
    ),
    1.3: (
        -0.08063, 13, 0.07, 0.4061, -54.18, -67.19, -43.87, 0.951, 25.38, 0.08306, -0.04744,
        0.08075, -0.03335, 0.02106, 0.26, 0.025, -0.05057, 4.961, 4.735, 0.24, 7, 4,
    ),
    1.8: (
        -0.09424, 14.88, 0.07, 0.41, -54.68, -71.44, -47.41, -0.6864, 28.14, 0.09708, -0.0472,
        0.1148, -0.1178, 0.036, 0.2697, 0.025, -0.07391, 5.539, 6.577, 0.24, 7.577, 4,
    ),
}
FITTED_RUNS: dict[float, tuple[float, ...]] = {
    2.0: (
        -0.2, 5.681, 0.015, 0.1488, -55.15, -70.86, -70.39, -9.048, 15.79, 0.1692, -0.03325,
        -0.1665, 0.0782, 0, 0.3, -0.011, 0.01386, 8.975, 7, 0.2, 9, 13.61,
    ),
    2.6: (
        -0.1828, 6.256, 0.01504, 0.158, -54.01, -75.67, -75.67, -16.2, 24.58, 0.1671, -0.02521,
        -0.1842, 0.0005834, 0, 0.3, 0.01476, 0.1695, 10.27, 7, 0.1971, 8.953, 12.89,
    ),
    3.2: (
        -0.1584, 6.34, 0.015, 0.1653, -50.08, -79, -79, -24.62, 29.89, 0.1459, -0.01656,
        -0.2526, -0.1114, 0, 0.3, -0.0107, 0.3105, 11.55, 7, 0.187, 8.995, 12.35,
    ),
    4.0: (
        -0.1532, -0.4395, 0.03495, 0.14, -47.54, -81.09, -81.09, -30.81, 35.31, 0.1511, -0.1025,
        -0.3108, -0.1637, 0, 0.3, -0.011, 0.2741, 12.43, 7, 0.1755, 9, 12.19,
    ),
}
# fmt: on


def walk(speed: float) -> Gait:
    """A walk at a speed, m/s; below the slowest that was fitted, its shape at another cadence."""
    quick = speed / 1.3
    return replace(
        walk_start(max(speed, 0.3)),
        **_fitted(FITTED_WALKS, speed),
        chest_yaw=2.0 + 3.0 * min(quick, 1.2),
        lean=2.0 + 1.5 * quick,
        arm=5.0 + 12.0 * quick,
        arm_mean=1.0 + 2.0 * quick,
        elbow=15.0 + 6.0 * quick,
        elbow_swing=3.0 + 6.0 * quick,
        wave=0.25 + 0.35 * quick,
    )


def run(speed: float) -> Gait:
    """A run at a speed, m/s."""
    quick = speed / 3.2
    return replace(
        run_start(speed),
        **_fitted(FITTED_RUNS, speed),
        chest_yaw=13.0,
        chest_at=-0.05,
        lean=5.0 + 5.0 * quick,
        arm=27.0 + 13.0 * quick,
        arm_mean=-6.0,
        arm_at=-0.05,
        elbow=88.0,
        elbow_swing=12.0,
        abduct=14.0,
        twist=34.0,
        head=1.0,
        curl=0.45,
        wave=1.1 + 1.1 * quick,
    )


def _fitted(table: dict[float, tuple[float, ...]], speed: float) -> dict[str, Any]:
    """Parameters at a speed, between those that were fitted."""
    speeds = np.array(list(table))
    values = PchipInterpolator(speeds, np.array(list(table.values())))(np.clip(speed, speeds[0], speeds[-1]))
    return dict(zip((*NAMES, "knee"), map(float, values), strict=True))
