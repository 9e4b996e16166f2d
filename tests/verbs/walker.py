"""Motions of a figure with two legs whose feet stand at known times, and verb sources of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.verbs.sources import example_row, write_source
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

BONE, HIP, ANKLE, HALF_WIDTH = 0.42, 0.8, 0.07, 0.1
"""Length of thigh and shin, heights of hips and ankles over flat feet, half of the distance of the hips, metres."""

LEG = ("UpLeg", "Leg", "Foot", "ToeBase")


def skeleton(names: tuple[str, ...] | None = None, *, toes: bool = True) -> Skeleton:
    """Hips, a head and two legs; ``names`` replaces the names, and without toes a foot ends at the ankle."""
    leg = LEG if toes else LEG[:3]
    own = ("Hips", "Chest", "Head", *(side + part for side in ("Left", "Right") for part in leg))
    parents, offsets = [-1, 0, 1], [[0, 0, 0], [0, 0.4, 0], [0, 0.2, 0]]
    for sign in (1.0, -1.0):
        first = len(parents)
        parents += [0, *range(first, first + len(leg) - 1)]
        offsets += [[sign * HALF_WIDTH, 0, 0], [0, -BONE, 0], [0, -BONE, 0], [0, -ANKLE, 0.13]][: len(leg)]
    tips = [k for k, name in enumerate(own) if name.endswith("ToeBase")]
    return Skeleton(
        names or own, np.array(parents), np.array(offsets, float), np.array(tips, np.int64),
        np.tile([0.0, 0.0, 0.07], (len(tips), 1)),
    )  # fmt: skip


def motion(hips, ankles, fps: float, body: Skeleton | None = None) -> Motion:
    """Hips (F, 3) and ankles (F, 2, 3), of which y and z count; feet stay level and knees bend forward."""
    body = body or skeleton()
    vectors = np.zeros((len(hips), len(body), 3))
    per_leg = (len(body) - 3) // 2
    for side in range(2):
        dy, dz = (ankles[:, side] - hips)[:, 1:].T
        lean, half = np.arctan2(dz, -dy), np.arccos(np.hypot(dy, dz) / (2 * BONE))
        first = 3 + side * per_leg
        vectors[:, first, 0], vectors[:, first + 1, 0], vectors[:, first + 2, 0] = -(lean + half), 2 * half, lean - half
    return Motion(body, fps, np.array(hips, float), quat.exp(vectors))


def walk(speed=1.2, cycle_s=1.0, stance=0.6, fps=60.0, lift=0.12, body=None) -> Motion:
    """One cycle; the left foot stands from 0 to ``stance`` of it, the right half a cycle later, then both wrap."""
    times = np.arange(round(cycle_s * fps) + 1) / fps
    hips = np.stack([np.zeros_like(times), np.full_like(times, HIP), speed * times], axis=-1)
    ankles = np.zeros((len(times), 2, 3))
    for side, shift in enumerate((0.0, 0.5)):
        share = times / cycle_s - shift
        step, part = np.floor(share), share % 1.0
        swing = np.clip((part - stance) / (1 - stance), 0.0, 1.0)
        stride = speed * cycle_s
        ankles[:, side, 2] = stride * (step + swing + shift + 0.5 * stance)
        ankles[:, side, 1] = ANKLE + lift * np.sin(np.pi * swing)
    return motion(hips, ankles, fps, body)


def jump(flight=(1.0, 1.5), length_s=2.5, fps=60.0, distance=0.5) -> Motion:
    """Both feet leave the ground at once and land at once."""
    times = np.arange(round(length_s * fps) + 1) / fps
    part = np.clip((times - flight[0]) / (flight[1] - flight[0]), 0.0, 1.0)
    rise = 0.3 * 4 * part * (1 - part)
    hips = np.stack([0 * times, HIP + rise, distance * part], axis=-1)
    ankles = np.stack([hips + np.array([0.0, ANKLE - HIP, 0.0])] * 2, axis=1)
    return motion(hips, ankles, fps)


def stand(length_s=2.0, fps=60.0, noise_m=0.0, slide_m_s=0.0, body=None, floor=0.0) -> Motion:
    """Hips that sway a little over feet that stand, or slide forward together with the hips."""
    times = np.arange(round(length_s * fps) + 1) / fps
    hips = np.stack([0 * times, floor + HIP + 0.01 * np.sin(3 * times), slide_m_s * times], axis=-1)
    ankles = np.stack([np.stack([0 * times, floor + ANKLE + 0 * times, slide_m_s * times], axis=-1)] * 2, axis=1)
    shake = noise_m * np.random.default_rng(1).standard_normal(hips.shape)
    return motion(hips + shake, ankles + shake[:, None], fps, body)


def source(folder: Path, motions: dict[str, Motion], *, looping=False, more="") -> Path:
    """A source whose one style adverb counts the motions."""
    rows = [example_row(name, [0.0, one.duration_s], [float(k)]) for k, (name, one) in enumerate(motions.items())]
    head = (
        f'name = "figure"\nlooping = {str(looping).lower()}\nkeytime_names = ["start", "end"]\n{more}\n'
        '[[adverb]]\nname = "mood"\nstyle = true\n'
    )
    return write_source(folder, motions, rows, head)
