"""Recordings of a channel: all frames that arrive, as arrays; written as npz, or for Rerun as rrd."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from adverb_client.channel import Channel
from adverb_client.errors import DecodeError
from adverb_client.records import CLAMPED, IN_TRANSITION
from adverb_client.skeleton import Skeleton
from adverb_client.wire import Record

__all__ = ["Recorder", "Recording"]

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

Frame = tuple[float, Record, str, dict[str, float]]
"""Time of the tick in seconds, record, verb, and goal by adverb."""

FORMAT = 1
POINT = ["x", "y", "z"]
BONES, GOAL, EFFECTOR = (122, 167, 255), (243, 176, 82), (79, 209, 165)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Frames of one channel; an npz file has the same names.

    Parameters
    ----------
    effector : str
        The effector's joint; empty if the verb is not measured by the position of one.
    adverbs : (D,) str
        Of all verbs of the recording.
    names : (J,) str
        Joints of the frames.
    parents : (J,) int64
    offsets : (J, 3) float64
    times_s : (F,) float64
        Time of each tick, seconds from the first.
    verbs : (F,) str
    phases, errors : (F,) float64
        Errors as in the records: NaN where nothing is measured.
    clamped, in_transition : (F,) bool
    versions : (F,) int64
    goals : (F, D) float64
        Goal in force when the frame arrived; NaN before the first, and for adverbs of other verbs.
    root : (F, 3) float32
    rotations : (F, J, 4) float32
        Relative to the parents.
    """

    effector: str
    adverbs: npt.NDArray[np.str_]
    names: npt.NDArray[np.str_]
    parents: npt.NDArray[np.int64]
    offsets: F64
    times_s: F64
    verbs: npt.NDArray[np.str_]
    phases: F64
    errors: F64
    clamped: Bools
    in_transition: Bools
    versions: npt.NDArray[np.int64]
    goals: F64
    root: F32
    rotations: F32

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton, without tips."""
        return Skeleton(tuple(self.names.tolist()), self.parents, self.offsets, np.zeros(0, np.int64), np.zeros((0, 3)))

    def positions(self) -> F64:
        """Positions (F, J, 3) of the joints, metres."""
        return self.skeleton.positions(self.root, self.rotations)

    def save_npz(self, path: str | Path) -> None:
        """Write an npz file: the fields of this class, and ``format``."""
        arrays: dict[str, Any] = {row.name: np.asarray(getattr(self, row.name)) for row in fields(self)}
        with Path(path).open("wb") as file:  # NumPy appends .npz to a name without it
            np.savez_compressed(file, format=np.int64(FORMAT), **arrays)

    @classmethod
    def load_npz(cls, path: str | Path) -> Recording:
        """Read a file of :meth:`save_npz`; raises :class:`DecodeError`."""
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as found:
                if int(found["format"]) != FORMAT:
                    raise DecodeError(f"{path}: format {int(found['format'])}; expected {FORMAT}")
                given: dict[str, Any] = {row.name: found[row.name] for row in fields(cls)}
        except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as err:
            raise DecodeError(f"{path}: no recording: {err}") from err
        return cls(**{**given, "effector": str(given["effector"])})

    def save_rrd(self, path: str | Path) -> None:
        """Write a file for Rerun: bones, goal and effector in space; error and phase over time.

        Raises
        ------
        ImportError
            If the package ``rerun-sdk`` (the extra ``rerun``) is not installed.
        """
        import rerun as rr

        stream = rr.RecordingStream("adverb", recording_id=f"{self.verbs[0]}-{len(self)}")
        stream.save(str(path))
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        positions, children = self.positions(), np.arange(1, len(self.names))
        strips = np.stack([positions[:, self.parents[children]], positions[:, children]], axis=2)
        joint = self.names.tolist().index(self.effector) if self.effector in self.names else -1
        names = self.adverbs.tolist()
        points = [names.index(name) for name in POINT] if set(POINT) <= set(names) else []
        for k, time_s in enumerate(self.times_s.tolist()):
            stream.set_time("time", duration=time_s)
            stream.log("world/figure", rr.LineStrips3D(strips[k], colors=BONES, radii=0.012))
            if joint >= 0:
                stream.log("world/effector", rr.Points3D(positions[k, joint], colors=EFFECTOR, radii=0.03))
            if points and np.isfinite(self.goals[k, points]).all():
                stream.log("world/goal", rr.Points3D(self.goals[k, points], colors=GOAL, radii=0.025))
            if np.isfinite(self.errors[k]):
                stream.log("error_m", rr.Scalars(float(self.errors[k])))
            stream.log("phase", rr.Scalars(float(self.phases[k])))
        stream.flush()
        stream.disconnect()

    def save(self, path: str | Path) -> None:
        """Write ``.rrd`` or ``.npz``, by the ending; raises ValueError for another one."""
        writers = {".rrd": self.save_rrd, ".npz": self.save_npz}
        writer = writers.get(Path(path).suffix)
        if writer is None:
            raise ValueError(f"{path}: expected an ending of {', '.join(writers)}")
        writer(path)


@dataclass(slots=True)
class Recorder:
    """Collects the frames of a channel while it is open as a context manager.

    Parameters
    ----------
    channel : Channel
        With all joints, local space, and an encoding other than ``weights``.
    effector : str
        As of :class:`Recording`.

    Examples
    --------
    >>> with Recorder(channel) as recorder:
    ...     time.sleep(3)
    >>> recorder.recording().save("reach.rrd")
    """

    channel: Channel
    effector: str = ""
    _frames: list[Frame] = field(default_factory=list)

    def __enter__(self) -> Self:
        info = self.channel.info
        if info.encoding == "weights" or info.space != "local" or len(info.joints) != len(info.skeleton):
            raise ValueError("a recording needs all joints, local space, and no weights")
        self.channel.observers.append(self._add)
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None) -> None:
        self.channel.observers.remove(self._add)

    def __len__(self) -> int:
        return len(self._frames)

    def _add(self, due_s: float, record: Record) -> None:
        info, goal = self.channel.info, self.channel.desired.get("adverbs", {})
        self._frames.append((due_s, record, info.verb, {row.name: goal.get(row.name, np.nan) for row in info.adverbs}))

    def recording(self) -> Recording:
        """What has been recorded so far; raises ValueError if that is nothing."""
        frames = list(self._frames)
        if not frames:
            raise ValueError("no frame has arrived")
        return _recording_of(frames, self.effector, self.channel.info.skeleton)


def _recording_of(frames: Sequence[Frame], effector: str, skeleton: Skeleton) -> Recording:
    times_s, records, verbs, goals = zip(*frames, strict=True)
    adverbs = list(dict.fromkeys(name for goal in goals for name in goal))
    flags = np.array([record.flags for record in records])
    return Recording(
        effector=effector,
        adverbs=np.array(adverbs),
        names=np.array(skeleton.names),
        parents=skeleton.parents,
        offsets=skeleton.offsets,
        times_s=np.array(times_s) - times_s[0],
        verbs=np.array(verbs),
        phases=np.array([record.phase for record in records], np.float64),
        errors=np.array([record.error for record in records], np.float64),
        clamped=(flags & CLAMPED) != 0,
        in_transition=(flags & IN_TRANSITION) != 0,
        versions=np.array([record.version for record in records], np.int64),
        goals=np.array([[float(goal.get(name, np.nan)) for name in adverbs] for goal in goals]),
        root=np.stack([record.root for record in records if record.root is not None]),
        rotations=np.stack([record.rotations for record in records if record.rotations is not None]),
    )
