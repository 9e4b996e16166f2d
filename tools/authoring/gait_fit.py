"""Fit the parameters of a stride to published joint curves: ``python -m tools.authoring.gait_fit``.

Prints the table :data:`tools.authoring.gait_table.FITTED`. Least squares over the angles of hip, knee and ankle at even
phases, the clearance of the toes and the range of the pelvis, with a weak pull to a first guess.

Sources: walking, J. Perry, J. Burnfield, "Gait Analysis", 2010, D. Winter, "Biomechanics and Motor Control of Human
Movement", 2009, and M. Kadaba et al., 1990, digitised; running, T. Novacheck, "The Biomechanics of Running", 1998.
Cadence and duty: J. Franz, R. Kram, 2012. The vertical range of the centre of mass: M. Orendurff et al., 2004. Change
with speed: C. Fukuchi et al., 2019.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from tools.authoring.gait import leg_angles
from tools.authoring.gait_model import Gait
from verbs.conventions import F64

__all__ = ["NAMES", "RUNS", "WALKS", "fit", "run_start", "targets", "walk_start"]

WALKS, RUNS = (0.5, 0.9, 1.3, 1.8), (2.0, 2.6, 3.2, 4.0)
"""Speeds at which walks and runs are fitted, m/s."""

_WALK = {
    "hip": ((0, 30), (10, 25), (30, 10), (50, -10), (62, -5), (75, 25), (85, 32), (100, 30)),
    "knee": ((0, 5), (12, 18), (25, 5), (40, 3), (55, 35), (70, 62), (85, 25), (95, 8), (100, 5)),
    "ankle": ((0, 0), (8, -5), (25, 5), (40, 10), (55, 5), (62, -15), (70, -5), (85, 0), (100, 0)),
}
_RUN = {
    "thigh": ((0, 28), (15, 20), (38, -20), (45, -19), (60, 8), (80, 41), (90, 38), (100, 28)),
    "knee": ((0, 16), (15, 43), (36, 20), (50, 45), (66, 95), (80, 60), (92, 20), (100, 16)),
    "ankle": ((0, 4), (18, 23), (38, -18), (45, -15), (60, 0), (80, 4), (100, 4)),
}
_COUNT = 40

NAMES = (
    "ahead", "strike", "flat", "heel_off", "push", "trail", "fold", "swing", "late", "early_lift", "late_lift",
    "early_ahead", "late_ahead", "rise", "rise_at", "surge", "surge_at", "tilt", "list", "list_at", "yaw",
)  # fmt: skip
"""Parameters that are fitted, and below how far each may go from its first guess, and how far it goes easily."""
_FREE: dict[str, tuple[float, float]] = {
    "ahead": (0.2, 0.1), "strike": (12.0, 6.0), "flat": (0.035, 0.03), "heel_off": (0.09, 0.06), "push": (16.0, 8.0),
    "trail": (24.0, 10.0), "fold": (24.0, 10.0), "swing": (24.0, 10.0), "late": (15.0, 8.0),
    "early_lift": (0.2, 0.1),
    "late_lift": (0.2, 0.1), "early_ahead": (0.3, 0.1), "late_ahead": (0.3, 0.1),
    "rise": (0.012, 0.006), "rise_at": (0.10, 0.04), "surge": (0.015, 0.006), "surge_at": (0.2, 0.1),
    "tilt": (6.0, 3.0), "list": (3.0, 1.5), "list_at": (0.08, 0.04), "yaw": (3.0, 2.0),
}  # fmt: skip
_FREE_WALK = {
    "strike": (4.0, 4.0), "flat": (0.02, 0.02), "push": (14.0, 9.0), "trail": (16.0, 9.0), "late": (8.0, 6.0),
    "list": (2.0, 1.5), "yaw": (2.5, 2.0),
}  # fmt: skip
_TOE_M, _CLEAR_M = 0.020, 0.033
"""Height of a standing toe joint, and of the toes that swing past the ground: 1.3 cm more."""


def walk_start(speed: float) -> Gait:
    """First guess of a walk."""
    stride_s = 1.0 / (0.93 * (speed / 1.25) ** 0.41)
    quick = speed / 1.3
    return Gait(
        stride_s=stride_s,
        duty=0.62 - 0.015 * speed,
        strike=17.0 * min(1.0, 0.4 + 0.6 * quick),
        push=-44.0 * min(1.1, 0.6 + 0.4 * quick),
        trail=-58.0 * min(1.1, 0.6 + 0.4 * quick),
        rise=float(np.interp(speed, (0.5, 0.7, 1.6, 1.8), (0.009, 0.0125, 0.023, 0.024))),
        sway=float(np.interp(speed, (0.5, 0.7, 1.6, 1.8), (0.036, 0.033, 0.019, 0.018))),
        knee=4.0,
        dip=float(np.interp(speed, (1.3, 1.8), (0.012, 0.006))),
        yaw=3.0 + 1.5 * quick,
        list=2.5 + 1.5 * quick,
    )


def run_start(speed: float) -> Gait:
    """First guess of a run."""
    return Gait(
        stride_s=2.0 / float(np.interp(speed, (2.0, 2.6, 3.2, 4.0), (2.6, 2.68, 2.76, 2.9))),
        duty=float(np.interp(speed, (2.0, 2.6, 3.2, 4.0), (0.40, 0.37, 0.34, 0.305))),
        width=0.03,
        turn_out=4.0,
        strike=4.0,
        flat=0.05,
        heel_off=0.17,
        push=-48.0,
        trail=-68.0,
        swing=-50.0,
        late=6.0,
        early_lift=0.22,
        late_lift=0.05,
        early_ahead=-0.05,
        late_ahead=0.05,
        knee=15.0,
        flight=True,
        rise=0.0,
        surge=0.004,
        sway=0.008,
        sway_at=0.18,
        tilt=12.0,
        list=4.0,
        list_at=0.12,
        yaw=6.0,
    )


def targets(speed: float, *, run: bool) -> dict[str, F64]:
    """Published curves at even phases, degrees, scaled to a speed by their trends."""
    phases = np.arange(_COUNT) / _COUNT
    found = {}
    for name, knots in (_RUN if run else _WALK).items():
        at, values = np.array(knots, np.float64).T
        found[name] = np.asarray(PchipInterpolator(at / 100.0, values)(phases))
    if run:
        share = float(np.interp(speed, (2.0, 3.2, 4.0), (0.74, 1.0, 1.12)))
        found["thigh"] = 6.0 + (found["thigh"] - 6.0) * share
        found["knee"] = np.where(phases > 0.40, 20.0 + (found["knee"] - 20.0) * (0.3 + 0.7 * share), found["knee"])
        return found
    share = float(np.interp(speed, (0.6, 1.3, 1.8), (0.68, 1.0, 1.14)))
    found["hip"] = 10.0 + (found["hip"] - 10.0) * share
    stance = float(np.interp(speed, (0.6, 1.3, 1.8), (0.6, 1.0, 1.25)))
    swing = float(np.interp(speed, (0.6, 1.3, 1.8), (0.90, 1.0, 1.05)))
    found["knee"] = 4.0 + (found["knee"] - 4.0) * np.where(phases < 0.4, stance, swing)
    return found


def fit(start: Gait, speed: float) -> tuple[Gait, dict[str, float]]:
    """Fit a gait to the published curves.

    Parameters
    ----------
    start : Gait
        First guess, to which the parameters are drawn weakly.
    speed : float
        Metres per second.

    Returns
    -------
    gait : Gait
    rms : dict of str to float
        Difference from each curve, degrees.
    """
    wanted = targets(speed, run=start.flight)
    start = _with_pitches(start, wanted)
    guess = np.array([getattr(start, name) for name in NAMES])
    free = _FREE if start.flight else _FREE | _FREE_WALK
    reach, easy = (np.array([free[name][k] for name in NAMES]) for k in (0, 1))

    def gait_of(values: F64) -> Gait:
        fields: dict[str, Any] = dict(zip(NAMES, map(float, guess + reach * values), strict=True))
        return replace(start, **fields)

    def residuals(values: F64) -> F64:
        curves = leg_angles(gait_of(values[:-1]), speed, _COUNT, 0.9 + 0.2 * values[-1])
        parts = [(curves[name] - target) / 5.0 for name, target in wanted.items()]
        low = slice(round(_COUNT * (start.duty + 0.08)), round(_COUNT * 0.92))
        parts.append(np.minimum(curves["toe"][low] - _CLEAR_M, 0.0) / 0.002)
        parts.append(np.minimum(curves["toe"] - _TOE_M, 0.0) / 0.001)
        parts.append(np.minimum(curves["heel"] - _TOE_M, 0.0) / 0.001)
        # Ankle paths without kinks: second differences of the knee, which overshooting swings show first.
        bend = np.diff(curves["knee"], 2, append=curves["knee"][:2])
        parts.append(np.maximum(np.abs(bend) - 12.0, 0.0) / 4.0)
        parts.append(np.minimum(curves["knee"] - least, 0.0))
        parts.append(np.maximum(curves["sharp"] - softest, 0.0) / (5.0 if start.flight else 2.5))
        parts.append(0.8 * reach * values[:-1] / easy)
        return np.concatenate(parts)

    softest = 135.0 if start.flight else float(np.interp(speed, (0.5, 1.3, 1.8), (34.0, 60.0, 92.0)))
    least, begin = (15.0 if start.flight else 4.0), np.zeros(len(NAMES) + 1)
    solution = least_squares(residuals, begin, bounds=(-1.0, 1.0), diff_step=1e-4, max_nfev=80)
    found = gait_of(solution.x[:-1])
    curves = leg_angles(found, speed, 10 * _COUNT, 0.9 + 0.2 * solution.x[-1])
    found = replace(found, knee=max(float(curves["knee"].min()), 4.0))
    return found, errors(found, speed)


def _with_pitches(gait: Gait, wanted: Mapping[str, F64]) -> Gait:
    """First guess of the foot's pitches: those that the published angles of hip, knee and ankle add up to."""
    thigh = wanted["thigh"] if "thigh" in wanted else wanted["hip"] - gait.tilt
    pitch = thigh - wanted["knee"] + wanted["ankle"]
    duty = gait.duty
    at = {"push": duty, "trail": duty + 0.05, "fold": duty + 0.4 * (0.94 - duty), "swing": duty + 0.7 * (0.94 - duty),
          "late": 0.94}  # fmt: skip
    values: dict[str, Any] = {
        name: float(np.interp(phase, np.arange(_COUNT) / _COUNT, pitch)) for name, phase in at.items()
    }
    steepest = np.inf if gait.flight else 56.0 * min(1.1, 0.75 + 0.2 * gait.rise / 0.02)
    for name in ("push", "trail"):
        values[name] = max(values[name], -steepest)
    return replace(gait, strike=float(np.clip(pitch[0], 4.0, gait.strike)), **values)


def errors(gait: Gait, speed: float) -> dict[str, float]:
    """Root mean square difference from each published curve, degrees."""
    curves = leg_angles(gait, speed, _COUNT)
    wanted: Mapping[str, F64] = targets(speed, run=gait.flight)
    return {name: float(np.sqrt(np.mean((curves[name] - target) ** 2))) for name, target in wanted.items()}


def _values(gait: Gait) -> F64:
    return np.array([getattr(gait, name) for name in (*NAMES, "knee")])


def main() -> None:
    """Fit all speeds and print the table."""
    for speeds, start in ((WALKS, walk_start), (RUNS, run_start)):
        for speed in speeds:
            found, rms = fit(start(speed), speed)
            row = ", ".join(f"{value:.4g}" for value in _values(found))
            sys.stdout.write(f"    {speed}: ({row}),\n")
            sys.stderr.write(f"{speed}: {', '.join(f'{name} {value:.1f}' for name, value in rms.items())}\n")


if __name__ == "__main__":
    main()
