"""Standing at rest: both feet stay, the body breathes, sways and shifts its weight."""

from __future__ import annotations

import numpy as np

from tools.authoring.gait import Legs, solve_legs
from tools.authoring.gait_model import STRIDES, Contacts
from tools.authoring.humanoid import humanoid
from tools.authoring.steps import about
from verbs.conventions import F64
from verbs.kernels import quat
from verbs.motion import Motion

__all__ = ["LENGTH_S", "idle"]

LENGTH_S = 5.0
"""One breath, and the period of all sway: twelve breaths a minute."""

_SEED = 5
_STANDS = 0.64
"""Share of a stride in which a foot of a slow walk stands."""


def idle(fps: float) -> tuple[Motion, F64, Contacts]:
    """Author the loop of one breath.

    Returns
    -------
    motion : Motion
    keytimes : (5,) float64
        Even, named as those of a gait.
    contacts : mapping
        Intervals, s, in which the feet of a slow walk stand. Here they stand all the time; but a blend with a walk
        has to lift a foot once in a stride.
    """
    figure, rng = humanoid(), np.random.default_rng(_SEED)
    frames = round(LENGTH_S * fps)
    share = np.arange(frames + 1) / frames
    rest = figure.forward(figure.rest)
    rotations = np.tile(figure.rest.rotations, (frames + 1, 1, 1))
    shift, lunge, glance, turn = (
        _sway(rng, share, size) for size in ((0.009, 0.003), (0.004, 0.003), (2.0, 1.2), (0.8, 0.4))
    )
    breath = _breath(share)
    root = figure.rest.root + np.stack([shift, -0.002 + 0.002 * breath - 4.0 * shift**2, lunge], axis=-1)
    rotations[:, 0] = quat.mul(
        quat.mul(about(1, np.radians(turn)), about(2, 1.6 * shift)), quat.mul(rotations[:, 0], about(0, 0.5 * lunge))
    )
    small = np.radians(1.0)
    for name, axis, angle in (
        ("Spine", 2, -0.9 * shift), ("Spine1", 0, -0.5 * small * breath), ("Spine2", 0, -1.3 * small * breath),
        ("Spine", 1, -0.6 * np.radians(turn)), ("Neck", 0, 0.9 * small * breath - 0.4 * lunge),
        ("Head", 0, 0.7 * small * breath), ("Neck", 1, 0.4 * np.radians(glance)), ("Head", 1, 0.6 * np.radians(glance)),
        ("Head", 0, 0.25 * np.radians(np.roll(glance[:-1], frames // 3)[np.arange(frames + 1) % frames])),
    ):  # fmt: skip
        joint = figure.skeleton.index(name)
        rotations[:, joint] = quat.mul(rotations[:, joint], about(axis, angle))
    for sign, side in ((1.0, "Left"), (-1.0, "Right")):
        shoulder, arm, fore = figure.joints(*(side + part for part in ("Shoulder", "Arm", "ForeArm")))
        own = _sway(rng, share, (0.8, 0.6))
        rotations[:, shoulder] = quat.mul(rotations[:, shoulder], about(2, sign * 1.6 * small * breath))
        rotations[:, arm] = quat.mul(about(0, 1.2 * small * breath + np.radians(own)), rotations[:, arm])
        rotations[:, fore] = quat.mul(rotations[:, fore], about(1, -sign * np.radians(0.7 * (own + breath))))
    feet = figure.joints("LeftFoot", "RightFoot")
    facing = quat.rotate(rest[0][feet], np.array([0.0, 0.0, 1.0]))
    still = np.zeros((2, frames + 1))
    legs = Legs(
        still, np.repeat(rest[1][feet][:, None], frames + 1, axis=1),
        still + np.arctan2(facing[:, 0], facing[:, 2])[:, None], still, still,
    )  # fmt: skip
    rotations = solve_legs(figure, root, rotations, legs)
    keytimes = np.arange(2 * STRIDES + 1) * LENGTH_S / (2 * STRIDES)
    stride = LENGTH_S / STRIDES
    contacts = {
        (side + "Foot", part): sorted(
            (round((k + at) * stride % LENGTH_S, 4), round((k + at + _STANDS) * stride % LENGTH_S, 4))
            for k in range(STRIDES)
        )
        for side, at in (("Left", 0.0), ("Right", 0.5))
        for part in ("heel", "ball", "toe")
    }
    return Motion(figure.skeleton, fps, root, quat.unroll(rotations)), keytimes, contacts


def _sway(rng: np.random.Generator, share: F64, sizes: tuple[float, float]) -> F64:
    """Sway (F,) that closes after a breath: the first two harmonics, and a little of the third."""
    phases = rng.uniform(0.0, 1.0, 3)
    waves = [np.cos(2 * np.pi * (k + 1) * (share + phases[k])) for k in range(3)]
    return np.asarray(sizes[0] * waves[0] + sizes[1] * waves[1] + 0.4 * sizes[1] * waves[2])


def _breath(share: F64) -> F64:
    """How full the chest is (F,), 0 to 1: it fills in two fifths of a breath and empties in the rest."""
    fills, empties = share / 0.4, (share - 0.4) / 0.6
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.where(share < 0.4, fills, 1.0 + empties)))
