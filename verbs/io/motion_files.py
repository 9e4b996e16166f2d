"""Read and write motion files of every format, by their endings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from verbs.conventions import METRES_PER_UNIT
from verbs.errors import MotionFileError, UnknownName
from verbs.io import bvh, gltf, gltf_writer, npz, usd_writer, vrma_writer
from verbs.io.files import write_atomically
from verbs.io.humanoid import Humanoid
from verbs.io.joint_tracks import STRETCH_M
from verbs.io.report import CHANGES, Folded, Marks, MotionFile, Note, NoteKind, Report
from verbs.motion import Motion

__all__ = [
    "CHANGES",
    "ENDINGS",
    "WRITTEN",
    "Folded",
    "Marks",
    "MotionFile",
    "Note",
    "NoteKind",
    "Report",
    "clip_names",
    "dump",
    "read",
    "write",
]


def _read_bvh(path: Path, unit: str, root: str | None, stretch_m: float, clip: str | int | None) -> MotionFile:
    if clip not in (None, 0, ""):
        raise MotionFileError(path, None, "no choice of a clip: a BVH file holds one motion", f"clip {clip!r:.60}")
    return bvh.read_file(path, unit=unit, root=root, stretch_m=stretch_m)


def _read_gltf(path: Path, unit: str, root: str | None, stretch_m: float, clip: str | int | None) -> MotionFile:
    return gltf.read_file(path, unit=unit, root=root, stretch_m=stretch_m, clip=clip)


def _read_npz(path: Path, unit: str, root: str | None, stretch_m: float, clip: str | int | None) -> MotionFile:
    if clip not in (None, 0, ""):
        raise MotionFileError(path, None, "no choice of a clip: an .npz file holds one motion", f"clip {clip!r:.60}")
    return npz.read_file(path, unit=unit, root=root, stretch_m=stretch_m)


_READERS: dict[str, Callable[[Path, str, str | None, float, str | int | None], MotionFile]] = {
    ".bvh": _read_bvh,
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".npz": _read_npz,
}

ENDINGS = tuple(_READERS)
"""Endings of the files that :func:`read` takes, in lower case."""

WRITTEN = {".bvh": "bvh", ".glb": "glb", ".vrma": "vrma", ".npz": "npz", ".usd": "usd", ".usda": "usd"}
"""Endings of the files that :func:`write` makes, and their formats, which :func:`dump` takes."""


def read(
    path: str | Path,
    *,
    unit: str = "m",
    root: str | None = None,
    stretch_m: float = STRETCH_M,
    clip: str | int | None = None,
) -> MotionFile:
    """Read a motion file of any format, by its ending.

    Parameters
    ----------
    path : str or Path
        A ``.bvh``, ``.glb``, ``.gltf`` or ``.npz`` file.
    unit : str
        The file's unit of length, a key of ``conventions.METRES_PER_UNIT``.
    root : str, optional
        Joint that becomes the root; those above it are folded into it. Default: see
        :func:`verbs.io.joint_tracks.root_motion`.
    stretch_m : float
        Largest distance of a joint from its mean offset that is dropped, metres.
    clip : str or int, optional
        Name or index of the animation, where a file holds several. Default: the only one.

    Returns
    -------
    file : MotionFile
        The motion in metres, and the report.

    Raises
    ------
    MotionFileError
        The file is invalid, or its ending is not known; with path, place, expected, found and what to do.
    UnknownName
        The unit is not known.
    """
    path = Path(path)
    if unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        found = f"the ending '{path.suffix}'" if path.suffix else "no ending"
        raise MotionFileError(path, None, f"a file that ends in {', '.join(ENDINGS)}", found, "convert it first")
    return reader(path, unit, root, stretch_m, clip)


def dump(
    motion: Motion,
    form: str,
    *,
    unit: str = "m",
    mannequin: bool = True,
    name: str = "motion",
    extras: Mapping[str, Any] | None = None,
    humanoid: Humanoid | None = None,
) -> bytes:
    """Bytes of a motion file; equal arguments give equal bytes.

    Parameters
    ----------
    motion : Motion
    form : str
        One of the formats of :data:`WRITTEN`.
    unit : str
        Unit of length of BVH; the other formats are in metres.
    mannequin : bool
        Whether glb has a skinned body beside the skeleton.
    name : str
        Name of the animation in glb, vrma and usd.
    extras : mapping, optional
        JSON values about the motion, kept in glb, vrma and usd.
    humanoid : Humanoid, optional
        Bones of the skeleton for vrma, where its names do not tell them.

    Raises
    ------
    UnknownName
        The format is not known.
    RequestError
        The skeleton is no humanoid (vrma), or the extra ``usd`` is not installed.
    OutOfRange, MotionFileError
        The format cannot hold the rate or a joint's name.
    """
    match form:
        case "bvh":
            return bvh.dump(motion.scaled(1.0 / METRES_PER_UNIT[unit]), decimals=8).encode()
        case "glb":
            return gltf_writer.dump(motion, mannequin=mannequin, name=name, extras=extras)
        case "vrma":
            return vrma_writer.dump(motion, name=name, extras=extras, humanoid=humanoid)
        case "npz":
            return npz.dump(motion)
        case "usd":
            return usd_writer.dump(motion, name=name, extras=extras)
    raise UnknownName("format", form, dict.fromkeys(WRITTEN.values()))


def write(
    motion: Motion,
    path: str | Path,
    *,
    unit: str = "m",
    mannequin: bool = True,
    name: str = "motion",
    extras: Mapping[str, Any] | None = None,
) -> None:
    """Write a motion in the format of the file's ending, one of :data:`WRITTEN`, atomically.

    The other parameters and errors are those of :func:`dump`.

    Raises
    ------
    MotionFileError
        The ending is not one of those, or the file cannot be written.
    """
    form = WRITTEN.get(Path(path).suffix.lower())
    if form is None:
        raise MotionFileError(path, None, f"a name that ends in {' or '.join(WRITTEN)}", f"'{Path(path).name:.60}'")
    write_atomically(path, dump(motion, form, unit=unit, mannequin=mannequin, name=name, extras=extras))


def clip_names(path: str | Path) -> tuple[str, ...]:
    """Names of the motions in a file, each a ``clip`` of :func:`read`; one empty name where there is no choice.

    Raises
    ------
    MotionFileError
        A glTF file is invalid.
    """
    path = Path(path)
    return gltf.clip_names(path) if _READERS.get(path.suffix.lower()) is _read_gltf else ("",)
