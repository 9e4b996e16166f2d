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
        -0.0561, 6.723, 0.07912, 0.4054, -40.36, -54.59, -26.92, -0.8506, 12.83, 0.01516, -0.03366,
        0.02574, 0.0146, 0.004345, 0.2614, 0.01915, 0.05599, 3.984, 1.077, 0.1671, 1.511, 4,
    ),
    0.9: (
        -0.06795, 9.862, 0.07174, 0.4023, -48.01, -61.49, -31.83, -0.136, 19.31, 0.03786, -0.03773,
        0.0862, -0.0194, 0.0123, 0.2623, 0.02289, -0.008056, 4.347, 1.779, 0.1894, 4.803, 4,
    ),
    1.3: (
        -0.07893, 13, 0.07, 0.4057, -54.09, -67.34, -43.9, 1.823, 25.09, 0.08795, -0.05289,
        0.07559, -0.03129, 0.02083, 0.2613, 0.025, -0.0474, 4.951, 4.674, 0.24, 7, 4,
    ),
    1.8: (
        -0.09386, 15.02, 0.07, 0.41, -54.67, -71.44, -47.54, 1.147, 28.14, 0.1057, -0.05648,
        0.1115, -0.1045, 0.036, 0.2696, 0.025, -0.07371, 5.534, 6.577, 0.24, 7.577, 4,
    ),
}
FITTED_RUNS: dict[float, tuple[float, ...]] = {
    2.0: (
        -0.2, 6.065, 0.015, 0.1482, -55.19, -70.93, -70.43, -8.34, 15.27, 0.1724, -0.03335,
        -0.1711, 0.07842, 0, 0.3, -0.011, 0.01268, 9.041, 7, 0.2, 9, 13.65,
    ),
    2.6: (
        -0.1812, 6.524, 0.01506, 0.1596, -54.23, -75.84, -75.84, -15.4, 24.14, 0.1728, -0.02592,
        -0.1914, 0.003808, 0, 0.3, 0.0137, 0.1764, 10.22, 7, 0.2, 8.963, 13.01,
    ),
    3.2: (
        -0.1544, 6.577, 0.01502, 0.1727, -50.46, -78.91, -78.91, -22.99, 30.36, 0.1602, -0.02028,
        -0.2522, -0.09594, 0, 0.3, -0.01021, 0.2964, 11.42, 6.993, 0.1966, 8.949, 12.43,
    ),
    4.0: (
        -0.1406, 6.75, 0.01501, 0.1456, -45.91, -80.01, -80.01, -32.44, 35.41, 0.1036, -0.0224,
        -0.3122, -0.2012, 0, 0.3, -0.01098, 0.2641, 12.34, 7, 0.1789, 8.986, 11.89,
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


def run(speed: float, turn: float = 0.0) -> Gait:
    """A run at a speed, m/s, straight or turning, rad/s: in a curve the legs pass each other farther apart."""
    quick = speed / 3.2
    gait = replace(
        run_start(speed),
        **_fitted(FITTED_RUNS, speed),
        chest_yaw=13.0,
        chest_at=-0.05,
        lean=5.0 + 5.0 * quick,
        arm=27.0 + 13.0 * quick,
        arm_mean=-9.0,
        arm_at=-0.05,
        elbow=104.0,
        elbow_swing=12.0,
        abduct=22.0,
        twist=20.0,
        head=1.0,
        curl=0.45,
        wave=1.1 + 1.1 * quick,
    )
    apart = min(1.0, abs(turn))
    return replace(gait, width=0.05 + 0.06 * apart, out=0.075 + 0.04 * apart)


def _fitted(table: dict[float, tuple[float, ...]], speed: float) -> dict[str, Any]:
    """Parameters at a speed, between those that were fitted."""
    speeds = np.array(list(table))
    values = PchipInterpolator(speeds, np.array(list(table.values())))(np.clip(speed, speeds[0], speeds[-1]))
    return dict(zip((*NAMES, "knee"), map(float, values), strict=True))
