"""What a set of clips can be measured by, guessed with the evidence; and the measured adverbs of one clip."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.proposal.clips import Clip
from verbs.proposal.cycles import is_cycle
from verbs.proposal.features import stature

__all__ = ["ADVERBS", "Guess", "guess", "measured", "strangers"]

ADVERBS = {
    "joint_position": (("x", "m", "leftward (+X)"), ("y", "m", "upward (+Y)"), ("z", "m", "forward (+Z)")),
    "jump": (("distance", "m", "horizontal displacement of the root from start to end"),
             ("direction", "rad", "angle of that displacement from +Z, positive toward +X (left)"),
             ("height", "m", "highest root position less the first")),
    "root_velocity": (("forward_speed", "m/s", "mean speed along the facing direction"),
                      ("turn_rate", "rad/s", "mean rate of turn about +Y, positive to the left"),
                      ("sideways_speed", "m/s", "mean speed to the left")),
}  # fmt: skip
"""Names, units and descriptions of measured adverbs."""

_EFFECTOR = re.compile(r"hand|wrist|foot|ankle|paw|hoof", re.IGNORECASE)
_FINGER = re.compile(r"thumb|index|middle|ring|pinky|finger|digit|toe", re.IGNORECASE)

STILL_M_S = 0.15
"""A root slower than this rests; a cycle that travels does not, at either end."""

RESTING = 0.2
"""An effector that moves less than this share of the median rests."""

FLIGHT_SHARE = 0.03
"""A body flies if its root rises by this share of its stature, and its lowest joint too."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A measure, its effector's joint, and the evidence for both."""

    measure: str
    effector: int
    evidence: str


def guess(clips: list[Clip], *, measure: str | None = None, effector: str | None = None) -> Guess:
    """The measure of clips of one skeleton, and the effector, where they are not given.

    Most clips move alike at both ends and repeat there: ``root_velocity``. Most fly: ``jump``. Otherwise the position
    of the effector that moves most.
    """
    skeleton = clips[0].motion.skeleton
    joint = skeleton.index(effector) if effector else None
    moving, flying = sum(map(_moves_at_ends, clips)), sum(map(_flies, clips))
    if measure is None and effector is None and moving > len(clips) / 2:
        return Guess("root_velocity", 0, f"{moving} of {len(clips)} clips move at their first and last frame")
    if measure is None and effector is None and flying > len(clips) / 2:
        return Guess("jump", 0, f"root and feet leave the ground in {flying} of {len(clips)} clips")
    if measure in ("root_velocity", "jump"):
        return Guess(measure, joint or 0, "given")
    if joint is not None:
        return Guess("joint_position", joint, "effector given")
    candidates = _effectors(clips[0])
    moved = {k: float(np.median([_excursion(clip, k) for clip in clips])) for k in candidates}
    best = sorted(candidates, key=lambda k: -moved[k])[:3]
    words = ", ".join(f"{skeleton.names[k]} {moved[k]:.2f} m" for k in best)
    return Guess("joint_position", best[0], f"moves farthest from its start: {words} (median of the clips)")


def _effectors(clip: Clip) -> list[int]:
    """Joints that may be the effector: hands and feet by name, otherwise the ends of the limbs."""
    names = clip.motion.skeleton.names
    named = [k for k, name in enumerate(names) if _EFFECTOR.search(name) and not _FINGER.search(name)]
    parents = set(clip.motion.skeleton.parents.tolist())
    return named or [k for k in range(len(names)) if k not in parents and k]


def _excursion(clip: Clip, joint: int) -> float:
    """Greatest distance of a joint from its start, less what the root moves then, metres."""
    about = clip.positions[:, joint].astype(np.float64) - clip.positions[:, 0]
    return float(np.linalg.norm(about - about[0], axis=1).max())


def _moves_at_ends(clip: Clip) -> bool:
    """Whether a clip travels or turns at its first and its last frames, and ends in the pose in which it starts."""
    fps, count = clip.motion.fps, len(clip.motion)
    if count < 6:
        return False
    steps = np.linalg.norm(np.diff(clip.positions[:, 0, ::2].astype(np.float64), axis=0), axis=1) * fps
    steps = steps + 0.3 * stature(clip) * np.abs(np.diff(clip.headings)) * fps
    window = max(2, int(0.15 * fps))
    ends = steps[:window].mean(), steps[-window:].mean()
    long = clip.duration_s > 2.0
    return min(ends) > max(STILL_M_S, 0.3 * float(np.mean(steps))) and (long or is_cycle(clip))


def _flies(clip: Clip) -> bool:
    """Whether the root and the lowest joint rise well above where they start."""
    heights = clip.positions[..., 1].astype(np.float64)
    size = FLIGHT_SHARE * stature(clip)
    top = int(np.argmax(heights[:, 0]))
    usual = float(np.median(heights[: max(2, len(heights) // 10)].min(axis=1)))
    return bool(heights[top, 0] - heights[0, 0] > size and heights[top].min() - usual > size)


def strangers(clips: list[Clip], found: Guess) -> dict[str, str]:
    """Clips that do not do what is measured, by name, each with the reason: no jump, or an effector that rests."""
    name = clips[0].motion.skeleton.names[found.effector]
    if found.measure == "jump":
        return {clip.name: "is no jump: root and feet do not leave the ground" for clip in clips if not _flies(clip)}
    if found.measure == "joint_position" and found.effector:
        moved = [_excursion(clip, found.effector) for clip in clips]
        usual = float(np.median(moved))
        return {clip.name: f"'{name}' moves {own:.2f} m from its start, {usual:.2f} m in the median"
                for clip, own in zip(clips, moved, strict=True) if own < RESTING * usual}  # fmt: skip
    return {}


def measured(clip: Clip, measure: str, effector: int, keytimes: tuple[float, ...], keytime: int) -> F64:
    """Measured adverbs (3,) of a clip, in SI, as the build measures them.

    ``keytime`` is the index of the effector's keytime, or of a jump's apex.
    """
    motion = clip.motion
    frames = np.arange(len(motion)) / motion.fps
    if measure == "joint_position":
        chain = motion.skeleton.chain(effector)
        at = keytimes[keytime]
        rotations = quat.normalize(clip.at(quat.unroll(motion.rotations[:, chain]), np.array([at])))
        parents = np.arange(-1, len(chain) - 1)
        _, found = fk.forward(clip.at(motion.root, np.array([at])), rotations, parents, motion.skeleton.offsets[chain])
        return np.asarray(found[0, -1])
    if measure == "jump":
        start, top, end = clip.at(motion.root, np.array([keytimes[0], keytimes[keytime], keytimes[-1]]))
        x, _, z = end - start
        return np.array([np.hypot(x, z), np.arctan2(x, z), top[1] - start[1]])
    rate = clip.headings[-1] / frames[-1]
    fine = np.linspace(0.0, frames[-1], 8 * len(frames))
    x, z = np.diff(CubicSpline(frames, motion.root[:, [0, 2]])(fine), axis=0).T
    angle = rate * 0.5 * (fine[1:] + fine[:-1])
    forward, side = x * np.sin(angle) + z * np.cos(angle), x * np.cos(angle) - z * np.sin(angle)
    return np.asarray(np.array([forward.sum(), clip.headings[-1], side.sum()]) / frames[-1])
