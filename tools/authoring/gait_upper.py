"""Trunk, head and arms of a walk or a run: they balance the legs, and a wave runs through them after each landing."""

from __future__ import annotations

import numpy as np

from tools.authoring import hands
from tools.authoring.figure import Figure
from tools.authoring.gait_model import SIDES, Gait, Timeline, lean_of
from tools.authoring.steps import Path, about
from verbs.conventions import F64
from verbs.kernels import quat

__all__ = ["arms", "trunk"]

_WAVE_S, _WAVE_HZ, _WAVE_RISE_S = 0.07, 7.5, 0.012
"""Decay and frequency of the wave that a landing sends upward, and how fast it sets in."""
_WAVE = {"Spine": (0.010, 0.5), "Spine2": (0.020, 0.5), "Neck": (0.032, -0.8), "Head": (0.045, -0.5)}
"""Delay, s, and share of the wave in each joint of the trunk: the head counters in part."""


def trunk(figure: Figure, gait: Gait, path: Path, line: Timeline, pelvis: F64, rotations: F64) -> None:
    """Write the local rotations of spine, neck and head."""
    turn, lean = 2.0 * np.pi, lean_of(path)
    spine = figure.joints("Spine", "Spine1", "Spine2")
    yaw = (
        np.radians(gait.chest_yaw) * np.cos(turn * (line.phase - gait.chest_at)) * line.drift[4]
        + 0.12 * path.turn * gait.look
    )
    nod = np.radians(gait.lean) + np.radians(0.8) * np.cos(2 * turn * (line.phase - 0.08))
    side = -np.radians(0.35 * gait.list) * np.cos(turn * (line.phase - gait.list_at))
    chest = quat.mul(quat.mul(about(2, side - lean), about(1, yaw)), about(0, nod))
    bend = quat.log(quat.mul(quat.conjugate(pelvis), chest)) / len(spine)
    for joint, extra in zip(spine, (0.6, 0.0, -0.6), strict=True):
        rotations[:, joint] = quat.exp(bend + np.radians(gait.lift_chest) * extra * np.array([1.0, 0.0, 0.0]))
    look = quat.mul(
        quat.mul(
            about(1, np.full(len(line.times), gait.look * path.turn) + 0.12 * yaw), about(2, 0.2 * side - 0.4 * lean)
        ),
        about(0, np.radians(gait.head) + 0.15 * (nod - nod.mean())),
    )
    half = 0.5 * quat.log(quat.mul(quat.conjugate(chest), look))
    for joint in figure.joints("Neck", "Head"):
        rotations[:, joint] = quat.exp(half)
    for name, (delay, share) in _WAVE.items():
        joint = figure.skeleton.index(name)
        wave = share * _wave(gait, line, delay)
        rotations[:, joint] = quat.mul(rotations[:, joint], about(0, wave))


def arms(figure: Figure, gait: Gait, line: Timeline, rotations: F64) -> None:
    """Write the local rotations of shoulders, arms, hands and fingers."""
    turn = 2.0 * np.pi
    for side, (name, sign) in enumerate(SIDES):
        shift = 0.5 * (1 - side)
        joints = figure.joints(*(name + part for part in ("Shoulder", "Arm", "ForeArm", "Hand")))
        size = line.drift[5] if side else 2.0 - line.drift[5]
        swing = np.cos(turn * (line.phase - gait.arm_at - shift)) * size
        later = np.cos(turn * (line.phase - gait.arm_at - shift - 0.06)) * size
        last = np.cos(turn * (line.phase - gait.arm_at - shift - 0.12)) * size
        wave = _wave(gait, line, 0.03) * 2.5
        raised = np.radians(gait.arm_mean + 0.6 * gait.lean + gait.arm * swing)
        elbow = np.radians(gait.elbow + gait.elbow_swing * later) + wave
        hang = about(2, np.full(len(line.times), -sign * np.radians(90.0 - gait.abduct)))
        inward = about(0, np.full(len(line.times), np.radians(gait.twist)) + 0.12 * np.radians(gait.arm) * swing)
        arm = quat.mul(quat.mul(about(0, -raised), hang), inward)
        forward = np.radians(0.12 * gait.arm) * swing
        rotations[:, joints[0]] = quat.mul(
            about(1, -sign * forward), about(2, np.full(len(line.times), sign * np.radians(gait.shrug)))
        )
        rotations[:, joints[1]] = arm
        rotations[:, joints[2]] = about(1, -sign * np.maximum(elbow, np.radians(2.0)))
        rotations[:, joints[3]] = quat.mul(
            about(1, -sign * np.radians(4.0 + 0.2 * gait.arm * last)), about(2, sign * (np.radians(4.0) + 0.5 * wave))
        )
        if gait.curl:
            rotations[:] = hands.shape(figure, rotations, name, "fist", np.full(len(line.times), gait.curl))


def _wave(gait: Gait, line: Timeline, delay: float) -> F64:
    """Damped wave (F,) after each landing, of size 1."""
    since = np.mod(line.times[:, None] - line.strikes.ravel() - delay, line.length)
    shape = np.exp(-since / _WAVE_S) * (1.0 - np.exp(-since / _WAVE_RISE_S)) * np.sin(2 * np.pi * _WAVE_HZ * since)
    return np.asarray(np.radians(gait.wave) * shape.sum(axis=1))
