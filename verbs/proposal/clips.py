"""Raw clips: motions of a folder without ``verb.toml``, with joint positions and what is derived from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from verbs.clips import orientation
from verbs.clips.reports import Mend
from verbs.conventions import F32, F64
from verbs.errors import SourceError, VerbError
from verbs.io import motion_files
from verbs.io.motion_files import CHANGES, ENDINGS
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["Clip", "Refused", "clip_of", "read_clip", "read_folder", "scaled", "turned", "turned_back"]

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """One motion file.

    Parameters
    ----------
    path : Path
    motion : Motion
    positions : (F, J, 3) float32
        Joint positions in the space of the motion, metres.
    headings : (F,) float64
        Rotation of the root about +Y since the first frame, radians, continuous.
    notes : tuple of str
        What the reader changed or left out, and what was mended.
    mends : tuple of Mend
        Applied to the motion of the file.
    start_s : float
        Seconds of the file at which the motion begins: mends may cut off what is before.
    """

    path: Path
    motion: Motion
    positions: F32
    headings: F64
    notes: tuple[str, ...] = ()
    mends: tuple[Mend, ...] = ()
    start_s: float = 0.0

    @property
    def name(self) -> str:
        """Name of the file with its ending."""
        return self.path.name

    @property
    def duration_s(self) -> float:
        """Seconds from the first frame to the last."""
        return self.motion.duration_s

    def times(self, rate_hz: float) -> F64:
        """Instants (n,) of about this rate, both ends included, seconds."""
        count = max(2, int(np.ceil(self.duration_s * rate_hz)) + 1)
        return np.linspace(0.0, self.duration_s, count)

    def at(self, values: F64 | F32, times: F64) -> F64:
        """Values (F, …) of all frames at ``times`` (n,), by cubic splines."""
        frames = np.arange(len(self.motion)) / self.motion.fps
        if len(frames) < 4:
            flat = np.asarray(values, np.float64).reshape(len(frames), -1)
            found = np.stack([np.interp(times, frames, column) for column in flat.T], axis=-1)
            return np.asarray(found.reshape(len(times), *values.shape[1:]))
        return np.asarray(CubicSpline(frames, np.asarray(values, np.float64))(times))

    def path_of(self, joint: int, times: F64) -> F64:
        """Positions (n, 3) of a joint at times (n,)."""
        return self.at(self.positions[:, joint], times)


@dataclass(frozen=True, slots=True)
class Refused:
    """A file that takes no part: its name, what is wrong, what to do, and whether it could be read at all."""

    name: str
    problem: str
    advice: str
    readable: bool = True


def clip_of(path: Path, motion: Motion, notes: tuple[str, ...] = ()) -> Clip:
    """A clip of a motion in metres."""
    skeleton = motion.skeleton
    positions = np.empty((len(motion), len(skeleton), 3), np.float32)
    for first in range(0, len(motion), 4096):  # bounded memory: global rotations are not kept
        part = slice(first, first + 4096)
        _, found = fk.forward(motion.root[part], motion.rotations[part], skeleton.parents, skeleton.offsets)
        positions[part] = found
    return Clip(path, motion, positions, _headings(motion), notes)


def _headings(motion: Motion) -> F64:
    """Rotation about +Y from the first frame's root rotation, which does not depend on the root's local axes."""
    root = quat.unroll(motion.rotations[:, 0])
    since = quat.mul(root, quat.conjugate(root[0]))
    return np.asarray(2.0 * np.unwrap(np.arctan2(since[:, 1], since[:, 3])))


def read_clip(path: Path, unit: str = "m") -> Clip:
    """Read one file; raises :class:`verbs.errors.MotionFileError`."""
    file = motion_files.read(path, unit=unit)
    return clip_of(path, file.motion, tuple(note.text for note in file.report.notes if note.kind in CHANGES))


def read_folder(folder: Path, *, unit: str, report: Progress) -> tuple[list[Clip], list[Refused]]:
    """Read every motion file of a folder, in the order of their names; those that cannot be read are named.

    Raises
    ------
    SourceError
        If the folder does not exist or holds no motion file.
    """
    if not folder.is_dir():
        raise SourceError(folder, "is not a folder; name the folder that holds the clips")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.is_file())
    if not paths:
        raise SourceError(folder, f"holds no motion files ({', '.join(ENDINGS)}); name the folder that holds the clips")
    clips: list[Clip] = []
    refused: list[Refused] = []
    for k, path in enumerate(paths):
        report("reading clips", k, len(paths))
        try:
            clips.append(read_clip(path, unit))
        except VerbError as err:
            problem = str(err).removeprefix(f"{path}:").removeprefix(f"{path}").strip()
            refused.append(Refused(path.name, f"cannot be read: line {problem}" if problem[:1].isdigit()
                                   else f"cannot be read: {problem}", "export it again", readable=False))  # fmt: skip
    report("reading clips", len(paths), len(paths))
    return clips, refused


def scaled(clip: Clip, factor: float) -> Clip:
    """A clip with all lengths multiplied."""
    if factor == 1.0:
        return clip
    return replace(clip, motion=clip.motion.scaled(factor), positions=clip.positions * np.float32(factor))


def turned(clip: Clip, up: str, forward: str) -> Clip:
    """A clip whose axes ``up`` and ``forward`` have become +Y and +Z."""
    return clip_of(clip.path, orientation.convert(clip.motion, up=up, forward=forward), clip.notes)


def turned_back(clip: Clip, up: str, forward: str) -> Clip:
    """The inverse of :func:`turned`."""
    axes = [orientation.AXES[name] for name in (up, forward)]
    rows = np.stack([np.cross(*axes), *axes])  # of the rotation that turns the file's axes to +X, +Y, +Z
    return turned(clip, orientation.axis_name(rows[:, 1]), orientation.axis_name(rows[:, 2]))
