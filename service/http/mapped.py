"""Evaluated poses on another skeleton, with the figures of the mapping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from service.catalog.catalog import Entry
from service.http.request_models import Options
from verbs.kernels import pose as kernels
from verbs.mapping.mapper import Figures, Mapped, Mapper
from verbs.mapping.mapping import of_preset
from verbs.mapping.rig import Rig
from verbs.runtime import describe
from verbs.runtime.evaluate import Poses
from verbs.skeleton import Skeleton

__all__ = ["COST_US", "PREPARE_US", "Shown", "mapped_poses", "prepared"]

COST_US = 12.0
"""Estimated time of one mapped pose, µs, with that at the keytime, of which the effector's figure is taken."""

PREPARE_US = 50_000.0
"""Estimated time to prepare a mapping of a verb, µs; the first request of one does."""

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """Poses of a target in the space and with the joints of the request.

    Parameters
    ----------
    poses : Poses
        With the root and the rotations of the target, whole and local.
    rotations : (B, J, 4) float32
    positions : (B, J, 3) float32 or None
    skeleton : Skeleton
        Of the target.
    head : mapping
        The object ``map`` of the response.
    figures : list of Figures
        One for each pose; one for all frames of a motion.
    rig : Rig
        The target.
    """

    poses: Poses
    rotations: F32
    positions: F32 | None
    skeleton: Skeleton
    head: dict[str, Any]
    figures: Sequence[Figures]
    rig: Rig


def prepared(entry: Entry, options: Options) -> bool:
    """Whether the mapping of a request has been prepared."""
    return (options.map, options.map_goal) in entry.mappers


def _mapper(entry: Entry, name: str, goal: str) -> Mapper:
    """The mapper of a verb to a preset, made once.

    Raises
    ------
    UnknownName
        There is no such preset.
    RequestError
        The verb has no joint that could be mapped.
    """
    key = (name, goal)
    found = entry.mappers.get(key)
    if found is None:
        found = entry.mappers.setdefault(key, Mapper.of_verb(entry.evaluator, of_preset(name, goal=goal)))
    return found


def mapped_poses(entry: Entry, found: Poses, options: Options, *, fps: float | None = None) -> Shown:
    """Poses on the skeleton that a request names; frames of one motion where ``fps`` is given."""
    assert options.map is not None
    mapper = _mapper(entry, options.map, options.map_goal)
    done = mapper.poses(found)
    poses = replace(found, root=done.root, rotations=done.rotations, root_velocity=_velocity(found, mapper))
    chosen = describe.joint_indices(mapper.skeleton, options.joints)
    rotations, positions = _in_space(mapper.skeleton, poses, options.space)
    if chosen is not None:
        rotations, positions = rotations[:, chosen], None if positions is None else positions[:, chosen]
    head = {
        "name": options.map, "goal": options.map_goal, "scale": mapper.tables.scale,
        "joints": list(options.joints or mapper.skeleton.names),
    }  # fmt: skip
    shown = np.ascontiguousarray(rotations, np.float32)
    places = None if positions is None else np.ascontiguousarray(positions, np.float32)
    figures = _figures(entry, mapper, found, done, fps)
    return Shown(poses, shown, places, mapper.skeleton, head, figures, mapper.mapping.rig)


def _figures(entry: Entry, mapper: Mapper, found: Poses, done: Mapped, fps: float | None) -> Sequence[Figures]:
    if fps is None:
        return mapper.figures(entry.evaluator, found, done)
    return [mapper.motion_figures(entry.evaluator, found, done, fps)]


def _velocity(found: Poses, mapper: Mapper) -> npt.NDArray[np.float64] | None:
    """Velocity of the root: that of the source, whose lengths are scaled over the ground."""
    if found.root_velocity is None:
        return None
    travel = float(mapper.tables.driven.scale[0])
    return np.asarray(found.root_velocity * np.array([travel, travel, 1.0]))


def _in_space(
    skeleton: Skeleton, poses: Poses, space: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64] | None]:
    if space != "global":
        return poses.rotations, None
    turns, places = np.empty_like(poses.rotations), np.empty((*poses.rotations.shape[:2], 3))
    kernels.forward(poses.root, poses.rotations, skeleton.parents, skeleton.offsets, turns, places)
    return turns, places
