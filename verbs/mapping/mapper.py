"""Poses and motions of a verb on another skeleton, with the two figures: effector and feet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.kernels import pose as kernels
from verbs.kernels.compile import direct
from verbs.kernels.mapped_limbs import FOOT_COLUMNS
from verbs.kernels.mapped_pose import map_poses
from verbs.mapping.mapping import Mapping
from verbs.mapping.plan import with_given_bones
from verbs.mapping.source import Source
from verbs.mapping.tables import Tables, tables
from verbs.motion import Motion
from verbs.runtime.evaluate import Blend, Evaluator, Poses
from verbs.skeleton import Skeleton

__all__ = ["Figures", "Mapped", "Mapper"]

_map_poses = direct(map_poses)

PLANTED_M, BALL_M, PLANTED_MPS = 0.012, 0.015, 0.1
"""A foot stands where neither the source's lowest point nor its ball is higher above its standing height, and where the
ball is slower over the ground."""


@dataclass(frozen=True, slots=True)
class Figures:
    """How well a mapping keeps what counts.

    Parameters
    ----------
    effector_m : float or None
        Distance of the effector from its goal at its keytime; None without one.
    foot_height_m : float or None
        Largest distance of a standing foot from the ground; None where no foot stands.
    foot_slide_m : float or None
        Largest distance of a standing foot from where it stands, over the ground.
    """

    effector_m: float | None
    foot_height_m: float | None
    foot_slide_m: float | None

    def as_dict(self) -> dict[str, float | None]:
        """The figures as JSON values."""
        return {
            "effector_m": self.effector_m, "foot_height_m": self.foot_height_m, "foot_slide_m": self.foot_slide_m,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """Poses of a target.

    Parameters
    ----------
    root : (B, 3) float64
    rotations : (B, J, 4) float64
        Local ones.
    effector : (B,) float64
        Distance of the effector from its goal in each pose; NaN without one.
    feet : (B, F, 6) float64
        Columns of :data:`verbs.kernels.mapped_limbs.FOOT_COLUMNS`.
    """

    root: F64
    rotations: F64
    effector: F64
    feet: F64


class Mapper:
    """A mapping of one skeleton to another, for any number of threads at once.

    Parameters
    ----------
    source : Source
    mapping : Mapping

    Attributes
    ----------
    skeleton : Skeleton
        Of the target.
    tables : Tables
    """

    def __init__(self, source: Source, mapping: Mapping) -> None:
        self.source, self.mapping = source, with_given_bones(source.rig, mapping)
        self.tables: Tables = tables(source, self.mapping)
        self.skeleton: Skeleton = mapping.rig.skeleton

    @classmethod
    def of_verb(cls, evaluator: Evaluator, mapping: Mapping) -> Mapper:
        """The mapper of a verb."""
        return cls(Source.of_verb(evaluator), mapping)

    def poses(self, poses: Poses) -> Mapped:
        """Poses of the verb on the target."""
        return self._mapped(poses.root, poses.rotations, self._weights(poses.phase))

    def motion(self, motion: Motion, phases: F64 | None = None) -> tuple[Motion, Mapped]:
        """A motion of the source's skeleton on the target; the effector has its goal by canonical times (F,)."""
        weights = np.zeros(len(motion)) if phases is None else self._weights(phases)
        found = self._mapped(motion.root, motion.rotations, weights)
        return Motion(self.skeleton, motion.fps, found.root, found.rotations), found

    def sequence(self, evaluator: Evaluator, poses: Poses, fps: float) -> tuple[Motion, Figures]:
        """A whole motion of the verb on the target, with its figures."""
        found = self.poses(poses)
        figures = self.motion_figures(evaluator, poses, found, fps)
        return Motion(self.skeleton, fps, found.root, found.rotations), figures

    def motion_figures(self, evaluator: Evaluator, poses: Poses, found: Mapped, fps: float) -> Figures:
        """Figures of the frames of one motion; along a track the largest."""
        height, slide = sliding(found.feet, fps, self.tables.scale)
        effector = self.effector_distances(evaluator, poses.blend)
        return Figures(None if effector is None else float(effector.max()), height, slide)

    def effector_distances(self, evaluator: Evaluator, blend: Blend) -> F64 | None:
        """Distance (B,) of the effector from its goal at its keytime; None without an effector."""
        if self.source.effector is None or not self.tables.reach.kind:
            return None
        at = evaluator.pose_of(blend, phase=np.full(len(blend.weights), self.source.effector.phase))
        return self.poses(at).effector

    def figures(self, evaluator: Evaluator, poses: Poses, found: Mapped) -> list[Figures]:
        """Figures of single poses: feet of each pose, and the effector at the keytime of its blend."""
        reached = self.effector_distances(evaluator, poses.blend)
        rows = []
        for k, feet in enumerate(found.feet):
            stands = feet[:, 5] <= PLANTED_M
            height = float(np.abs(feet[stands, 1]).max()) if stands.any() else None
            slide = float(feet[stands, 2].max()) if stands.any() else None
            at = None if reached is None else float(reached[k if len(reached) > 1 else 0])
            rows.append(Figures(at, height, slide))
        return rows

    def _weights(self, phases: F64) -> F64:
        if self.source.effector is None:
            return np.zeros(len(phases))
        return self.source.effector.weights(phases, looping=self.source.looping)

    def _mapped(self, root: F64, rotations: F64, weights: F64) -> Mapped:
        size, table = len(root), self.tables
        skeleton = self.source.rig.skeleton
        globals_, positions = np.empty((size, len(skeleton), 4)), np.empty((size, len(skeleton), 3))
        kernels.forward(root, rotations, skeleton.parents, skeleton.offsets, globals_, positions)
        out: tuple[Any, ...] = (
            np.empty((size, 3)), np.empty((size, len(self.skeleton), 4)), np.empty(size),
            np.empty((size, len(table.soles.joints), len(FOOT_COLUMNS))),
        )  # fmt: skip
        _map_poses(globals_, positions, np.ascontiguousarray(weights), table.driven, table.soles, table.reach, *out)
        return Mapped(*out)


def sliding(feet: F64, fps: float, scale: float) -> tuple[float | None, float | None]:
    """Largest height error and slide of standing feet of a motion, metres; None where none stands.

    Parameters
    ----------
    feet : (F, n, 6) float64
    fps, scale : float
        Rate, and lengths of the target per length of the source.
    """
    heights, slides = [], []
    for f in range(feet.shape[1]):
        place = feet[:, f, 3:5]
        speed = np.linalg.norm(np.gradient(place, axis=0), axis=1) * fps / scale if len(place) > 1 else np.zeros(1)
        stands = (feet[:, f, 5] <= PLANTED_M) & (feet[:, f, 0] <= BALL_M) & (speed <= PLANTED_MPS)
        edges = np.diff(np.concatenate([[0], stands.astype(np.int64), [0]]))
        for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            heights.append(float(np.abs(feet[first:last, f, 1]).max()))
            run = place[first:last]
            slides.append(float(np.linalg.norm(run - run.mean(axis=0), axis=1).max()))
    return (max(heights), max(slides)) if heights else (None, None)
