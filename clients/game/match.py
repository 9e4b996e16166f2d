"""Rounds, score and balls of a game."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from actions import choose, stand_for
from balls import CAUGHT, FLYING, Ball
from fighter import Fighter, Result

F64 = npt.NDArray[np.float64]

BALLS = 8
"""Of a round."""

IN_AIR = 3
PACE_M_S, SETTLE_S, AFTER_S = 0.75, 0.5, 1.3
"""Walking; from standing to a switch; from a ball that is met until the figure walks again."""

LEAST_S = 1.9
GONE_S = 3.0
FULL, NEAR_M = 100, 0.14
"""Points of a perfect hit; they fall to a tenth at this distance."""


@dataclass(slots=True, eq=False)
class Match:
    """The state of a game.

    Parameters
    ----------
    thrower : (3,)
        Where balls come from.
    """

    thrower: F64
    balls: list[Ball] = field(default_factory=list)
    results: list[Result] = field(default_factory=list)
    notes: list[tuple[float, F64, str, bool]] = field(default_factory=list)
    round: int = 1
    thrown: int = 0
    score: int = 0
    combo: int = 0
    _busy_s: float = 0.0

    def throw(self, point: F64, now_s: float, fighter: Fighter, *, soft: bool) -> Ball | None:
        """Throw a ball that is at a point when the figure can be there; None if none is left or three are flying."""
        flying = [ball for ball in self.balls if ball.state == FLYING]
        if self.thrown >= BALLS or len(flying) >= IN_AIR:
            return None
        ball = Ball(self.thrower, point, now_s, now_s + LEAST_S, soft)
        action = fighter.actions[choose(ball)]
        before = flying[-1].meet if flying else None
        stand, _ = stand_for(action.verb, point, self.thrower)
        here = fighter.position if before is None else stand_for(choose(flying[-1]), before, self.thrower)[0]
        walk_s = float(np.linalg.norm(stand - here)) / PACE_M_S + SETTLE_S
        free_s = max(now_s, self._busy_s)
        ball.meet_s = max(now_s + LEAST_S, free_s + walk_s + action.time_s)
        self._busy_s = ball.meet_s + AFTER_S
        self.thrown += 1
        self.balls.append(ball)
        return ball

    def record(self, ball: Ball, result: Result) -> None:
        """Score a result."""
        self.results.append(result)
        points = points_of(result)
        self.combo = self.combo + 1 if result.met else 0
        self.score += points * min(self.combo, 3)
        text = f"+{points * min(self.combo, 3)}  {_millimetres(result.miss_m)}" if points else "missed"
        when_s = ball.meet_s if math.isnan(result.when_s) else result.when_s
        self.notes.append((when_s, ball.meet, text, result.met))

    def update(self, now_s: float) -> None:
        """Remove what is over; begin the next round."""
        self.balls = [
            ball for ball in self.balls
            if now_s < ball.meet_s + GONE_S or (ball.state == CAUGHT and now_s < ball.meet_s + 1.0)
        ]  # fmt: skip
        self.notes = [note for note in self.notes if now_s < note[0] + 2.0]
        if self.thrown >= BALLS and not self.balls:
            self.round, self.thrown = self.round + 1, 0

    @property
    def met(self) -> int:
        """Balls that were met."""
        return sum(result.met for result in self.results)

    @property
    def mean_miss_m(self) -> float:
        """Mean distance of those that were measured; NaN before the first."""
        found = [result.miss_m for result in self.results if not math.isnan(result.miss_m)]
        return sum(found) / len(found) if found else math.nan


def points_of(result: Result) -> int:
    """Points of a result: 100 for a perfect one, 10 for one that is just near enough."""
    return round(FULL * (1.0 - 0.9 * min(result.miss_m / NEAR_M, 1.0))) if result.met else 0


def _millimetres(metres: float) -> str:
    return "–" if math.isnan(metres) else f"{1e3 * metres:.0f} mm"
