"""State of the feet of moving characters: modes, and the places where they stand and go.

A place (8,) has x and z of heel, ball and tip (m), then the direction x, z of the foot. :mod:`verbs.kernels.feet`
changes the state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.stances import move_place, rotate_place

__all__ = [
    "FOOT",
    "LEAVE",
    "STANCE",
    "STAY",
    "STEP",
    "SWING",
    "load_next",
    "load_place",
    "store_next",
    "store_place",
    "to_world",
]

SWING, STANCE, STEP, LEAVE, STAY = range(5)
"""Modes: moves as its motion does; stands; steps to another place; stands no longer, since a step would come too late;
moves with its motion at a constant distance."""

_AXES = ("heel_x", "heel_z", "ball_x", "ball_z", "tip_x", "tip_z", "dx", "dz")

FOOT = np.dtype(
    [
        ("mode", "i8"),
        ("since_s", "f8"),  # since it left, or since its step began
        ("near", "f8"),  # share of the next place in the last frame; of a step, share that was held at its begin
        ("fade", "f8"),  # up to 1: how far heights are taken over; below 0 not yet
        *(
            (f"sunk_{point}", "f8") for point in ("heel", "ball", "tip")
        ),  # below its ground when its motion began, metres
        ("length_s", "f8"),  # of its step
        ("rise", "f8"),  # height of its step, metres
        ("give", "f8"),  # how its leg gives way, 0 to 2
        ("frames", "i8"),  # since it was last compared with its motion
        *((f"{when}{axis}", "f8") for when in ("", "next_") for axis in _AXES),
    ]
)
"""State of one foot of a character: its place in the world where it stands or stood last, and where it goes next."""


@kernel
def to_world(row: Any, place: F64) -> None:
    """Take a place (8,) from the motion's frame into the world, by a character's position."""
    rotate_place(place, np.cos(row["heading"]), np.sin(row["heading"]))
    move_place(place, row["x"], row["z"])


@kernel
def store_place(foot: Any, place: F64) -> None:
    """Keep a place (8,) as the one where a foot stands."""
    foot["heel_x"], foot["heel_z"], foot["ball_x"], foot["ball_z"] = place[0], place[1], place[2], place[3]
    foot["tip_x"], foot["tip_z"], foot["dx"], foot["dz"] = place[4], place[5], place[6], place[7]


@kernel
def load_place(foot: Any, place: F64) -> None:
    """Read the place (8,) where a foot stands."""
    place[0], place[1], place[2], place[3] = foot["heel_x"], foot["heel_z"], foot["ball_x"], foot["ball_z"]
    place[4], place[5], place[6], place[7] = foot["tip_x"], foot["tip_z"], foot["dx"], foot["dz"]


@kernel
def store_next(foot: Any, place: F64) -> None:
    """Keep a place (8,) as the one where a foot goes."""
    foot["next_heel_x"], foot["next_heel_z"] = place[0], place[1]
    foot["next_ball_x"], foot["next_ball_z"] = place[2], place[3]
    foot["next_tip_x"], foot["next_tip_z"] = place[4], place[5]
    foot["next_dx"], foot["next_dz"] = place[6], place[7]


@kernel
def load_next(foot: Any, place: F64) -> None:
    """Read the place (8,) where a foot goes."""
    place[0], place[1] = foot["next_heel_x"], foot["next_heel_z"]
    place[2], place[3] = foot["next_ball_x"], foot["next_ball_z"]
    place[4], place[5] = foot["next_tip_x"], foot["next_tip_z"]
    place[6], place[7] = foot["next_dx"], foot["next_dz"]
