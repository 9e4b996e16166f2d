"""The actions of the figure: which verb meets a ball, and from where."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from adverb_client import Client, Pose, quat
from balls import Ball
from placement import Placement, about_y

F64 = npt.NDArray[np.float64]

LOW_M = 0.78
"""Balls that are lower are kicked."""

PREFERRED = {"punch": (-0.1, 0.82), "kick": (-0.18, 0.8), "reach": (-0.25, 0.48)}
"""Where a verb meets a ball best, from the figure: left and forward, metres."""

MARGIN = 0.04
"""Share of a range that is kept free at its ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """A verb that meets something at a keytime.

    Parameters
    ----------
    verb : str
    effector : int
        Joint.
    phase : float
        Of the keytime.
    time_s : float
        From the start of the motion to the keytime, at speed 1.
    low, high : (3,)
        Range of the goals.
    first : Pose
        Pose at the start.
    """

    verb: str
    effector: int
    phase: float
    time_s: float
    low: F64
    high: F64
    first: Pose

    @classmethod
    def fetch(cls, client: Client, name: str) -> Action:
        """The action of a verb of the server."""
        verb = client.verb(name)
        phase = verb.keytimes[verb.measure["keytime"]]
        middle = {row.name: 0.5 * (row.min + row.max) for row in verb.adverbs}
        first, there = client.pose(name, middle, phase=0.0), client.pose(name, middle, phase=phase)
        return cls(
            name, verb.skeleton.index(verb.measure["effector"]), phase, there.time_s,
            np.array([row.min for row in verb.adverbs]), np.array([row.max for row in verb.adverbs]), first,
        )  # fmt: skip

    def placement(self, root: F64, rotation: F64, pose: Pose) -> Placement:
        """Where the motion is, from a root in the world (3,), (4,), and the pose of the verb that it shows."""
        return Placement.between(root, rotation, pose.root.astype(np.float64), pose.rotations[0].astype(np.float64))

    def goal(self, placement: Placement, point: F64) -> F64:
        """Adverbs (3,) for a point of the world, within the range."""
        free = MARGIN * (self.high - self.low)
        return np.asarray(np.clip(placement.local(point), self.low + free, self.high - free))


def choose(ball: Ball) -> str:
    """The verb for a ball, by its kind and height: soft ones are caught, low ones kicked, all others punched."""
    if ball.soft:
        return "reach"
    return "kick" if ball.meet[1] < LOW_M else "punch"


def stand_for(verb: str, point: F64, thrower: F64) -> tuple[F64, float]:
    """Position (3,) on the ground and heading, from which a verb meets a point, facing the thrower."""
    heading = math.atan2(thrower[0] - point[0], thrower[2] - point[2])
    left, forward = PREFERRED[verb]
    stand = point - quat.rotate(about_y(heading), np.array([left, 0.0, forward]))
    return stand * [1.0, 0.0, 1.0], heading
