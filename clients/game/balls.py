"""Balls: thrown to a point, and what becomes of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

GRAVITY = np.array([0.0, -1.6, 0.0])
"""Of foam balls, m/s²: slow enough to watch."""

RADIUS_M = 0.09
FLYING, STRUCK, CAUGHT, MISSED = "flying", "struck", "caught", "missed"


@dataclass(slots=True, eq=False)
class Ball:
    """A ball.

    Parameters
    ----------
    start, meet : (3,)
        Where it is thrown from, and where it is to be met, metres.
    thrown_s, meet_s : float
        When it is there, game time.
    soft : bool
        Whether it is to be caught; others are struck.
    """

    start: F64
    meet: F64
    thrown_s: float
    meet_s: float
    soft: bool
    state: str = FLYING
    ended_s: float = 0.0
    velocity: F64 = field(default_factory=lambda: np.zeros(3))
    at: F64 = field(default_factory=lambda: np.zeros(3))

    def position(self, now_s: float) -> F64:
        """Position (3,) at a time."""
        if self.state == CAUGHT and now_s >= self.ended_s:
            return self.at
        if self.state == STRUCK and now_s >= self.ended_s:
            since_s = now_s - self.ended_s
            return _above_ground(self.at + self.velocity * since_s + GRAVITY * since_s**2)
        since_s = now_s - self.thrown_s
        return _above_ground(self.start + self.first_velocity * since_s + 0.5 * GRAVITY * since_s**2)

    @property
    def first_velocity(self) -> F64:
        """Velocity (3,) with which it reaches the meeting point in time."""
        flight_s = self.meet_s - self.thrown_s
        return np.asarray((self.meet - self.start) / flight_s - 0.5 * GRAVITY * flight_s)

    def end(self, state: str, now_s: float, at: F64, velocity: F64) -> None:
        """Strike, catch or miss it."""
        self.state, self.ended_s, self.at, self.velocity = state, now_s, at, velocity


def _above_ground(point: F64) -> F64:
    return np.array([point[0], max(point[1], RADIUS_M), point[2]])


def closest(times_s: F64, points: F64, ball: Ball) -> tuple[float, float, F64]:
    """Smallest distance between an effector and a ball: metres, when, and where the effector is then.

    Parameters
    ----------
    times_s : (K,)
    points : (K, 3)
        Of the effector; straight between two of them.
    ball : Ball
    """
    others = np.stack([ball.position(time_s) for time_s in times_s.tolist()])
    apart = points - others
    if len(apart) == 1:
        return float(np.linalg.norm(apart[0])), float(times_s[0]), points[0]
    steps = np.diff(apart, axis=0)
    squares = np.maximum((steps**2).sum(axis=1), 1e-18)
    shares = np.clip(-(apart[:-1] * steps).sum(axis=1) / squares, 0.0, 1.0)
    distances = np.linalg.norm(apart[:-1] + shares[:, None] * steps, axis=1)
    k = int(np.argmin(distances))
    share = float(shares[k])
    when_s = float(times_s[k] + share * (times_s[k + 1] - times_s[k]))
    return float(distances[k]), when_s, points[k] + share * (points[k + 1] - points[k])
