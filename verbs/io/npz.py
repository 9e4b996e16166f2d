"""Motions as ``.npz`` archives of NumPy arrays, as motion generators write them; never unpickled.

Arrays, with J joints and F frames; lengths in the unit that the caller states:

====================  =====================  ==================================================================
``joint_names``       (J,) text              Required. Unique; parents stand before their children.
``parents``           (J,) integers          Required. -1 for joint 0.
``offsets``           (J, 3)                 Required. Position of each joint in its parent's frame.
``rotations``         (F, J, 4)              Local unit quaternions x, y, z, w; or
``rotation_matrices`` (F, J, 3, 3)           local rotation matrices, columns are the axes. One of the two.
``root_positions``    (F, 3)                 Required.
``fps``               () or (1,)             Required. Frames per second.
``tip_parents``       (T,) integers          Optional. Joints that end in a tip.
``tip_offsets``       (T, 3)                 Optional, with ``tip_parents``.
``contacts``          (F, P)                 Optional. 1 or true where a point is in contact, or a likelihood.
``contact_names``     (P,) text              Required with ``contacts``: names of joints.
====================  =====================  ==================================================================

Other arrays are ignored. Sizes are checked in the directory of the archive and in the header of each array before
anything is unpacked.
"""

from __future__ import annotations

import io
import math
import re
import struct
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64, I64, MAX_FRAMES, MAX_JOINTS, METRES_PER_UNIT
from verbs.errors import MotionFileError, SkeletonMismatch, UnknownName
from verbs.io.files import file_content, write_atomically
from verbs.io.joint_tracks import STRETCH_M, JointTracks, root_motion
from verbs.io.report import Marks, MotionFile, Report
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["dump", "read_file", "write"]

MAX_MEMBERS = 1_000
MAX_NAME = 200
_MAX_ROTATIONS = 20_000_000
_MAX_MAGNITUDE = 1e9
_MAX_BYTES = 640 * 1024 * 1024  # of one array: a small archive may hold a large one
_MAX_HEADER = 10_000
_ORTHOGONAL = 1e-2
_FPS = (1.0 / 60.0, 1e6)

_READS = (
    "joint_names", "parents", "offsets", "rotations", "rotation_matrices", "root_positions", "fps", "tip_parents",
    "tip_offsets", "contacts", "contact_names",
)  # fmt: skip

Array = np.ndarray[Any, Any]


def write(motion: Motion, path: str | Path, *, contacts: Marks | None = None) -> None:
    """Write a motion as ``.npz``, atomically; equal motions give equal bytes.

    Parameters
    ----------
    motion : Motion
    path : str or Path
    contacts : Marks, optional

    Raises
    ------
    MotionFileError
        The file cannot be written.
    """
    write_atomically(path, dump(motion, contacts=contacts))


def dump(motion: Motion, *, contacts: Marks | None = None) -> bytes:
    """Bytes of an ``.npz`` file; the parameters are those of :func:`write`."""
    skeleton = motion.skeleton
    arrays: dict[str, Array] = {
        "joint_names": np.array(skeleton.names),
        "parents": skeleton.parents,
        "offsets": skeleton.offsets,
        "rotations": motion.rotations,
        "root_positions": motion.root,
        "fps": np.array(motion.fps),
        "tip_parents": skeleton.tip_parents,
        "tip_offsets": skeleton.tip_offsets,
    }
    if contacts is not None:
        arrays |= {"contacts": contacts.values, "contact_names": np.array(contacts.names)}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            part = io.BytesIO()
            np.lib.format.write_array(part, np.ascontiguousarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), part.getvalue(), zipfile.ZIP_DEFLATED)
    return content.getvalue()


def read_file(
    path: str | Path, *, unit: str = "m", root: str | None = None, stretch_m: float = STRETCH_M
) -> MotionFile:
    """Read a motion from ``.npz``; the layout is that of this module.

    Parameters
    ----------
    path : str or Path
    unit : str
        Unit of lengths, a key of ``conventions.METRES_PER_UNIT``.
    root : str, optional
        Joint that becomes the root; see :func:`verbs.io.joint_tracks.root_motion`.
    stretch_m : float
        Has no effect: only the root of such a file moves.

    Returns
    -------
    file : MotionFile
        ``report.contacts`` holds the contacts, if there are any.

    Raises
    ------
    MotionFileError
        The file is invalid; its place is the name of an array.
    UnknownName
        The unit is not known.
    """
    if unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    arrays = _Arrays(Path(path), file_content(path))
    names = arrays.names("joint_names", MAX_JOINTS)
    joints = len(names)
    root_positions = arrays.numbers("root_positions", (-1, 3))
    frames = len(root_positions)
    if not 1 <= frames <= MAX_FRAMES or frames * joints > _MAX_ROTATIONS:
        expected = f"1 to {MAX_FRAMES} frames, and at most {_MAX_ROTATIONS} frames × joints"
        raise MotionFileError(path, "root_positions", expected, f"{frames} frames, {joints} joints")
    scale = METRES_PER_UNIT[unit]
    tips = arrays.indices("tip_parents", -1) if "tip_parents" in arrays else np.zeros(0, np.int64)
    tip_offsets = arrays.numbers("tip_offsets", (len(tips), 3)) if len(tips) else np.zeros((0, 3))
    tracks = JointTracks(
        names=names,
        parents=arrays.indices("parents", joints),
        offsets=scale * arrays.numbers("offsets", (joints, 3)),
        rotations=arrays.rotations(frames, joints),
        positions={0: scale * root_positions},
        tip_parents=tips,
        tip_offsets=scale * tip_offsets,
        fps=arrays.rate(),
        places=["joint_names"] * joints,
    )
    try:  # parents in order, names once
        Skeleton(names, tracks.parents, tracks.offsets, tracks.tip_parents, tracks.tip_offsets)
    except SkeletonMismatch as err:
        raise MotionFileError(path, "parents", "a tree of joints in depth-first order", str(err)) from err
    motion, notes, folded = root_motion(tracks, str(path), root=root, stretch_m=stretch_m)
    return MotionFile(motion, Report("npz", tuple(notes), folded, contacts=arrays.contacts(frames)))


class _Arrays:
    """The arrays of an archive, each unpacked and checked on request."""

    def __init__(self, path: Path, content: bytes) -> None:
        self.path = path
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(content))
            rows = self._archive.infolist()
        except _BROKEN as err:
            raise MotionFileError(path, None, "an .npz archive", f"{err}"[:200], "save it by numpy.savez") from err
        if len(rows) > MAX_MEMBERS:
            raise self._error(None, f"at most {MAX_MEMBERS} arrays", str(len(rows)))
        self._rows = {row.filename.removesuffix(".npy"): row for row in rows}

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def _error(self, name: str | None, expected: str, found: str, advice: str = "") -> MotionFileError:
        return MotionFileError(self.path, name, expected, found, advice)

    def names(self, name: str, most: int) -> tuple[str, ...]:
        """Texts (n,), 1 to ``most`` of them."""
        array = self._array(name, "U", most * MAX_NAME * 4)
        if array.ndim != 1 or not 1 <= len(array) <= most:
            raise self._error(name, f"1 to {most} texts", f"shape {array.shape}")
        codes = array.view(np.dtype("u4").newbyteorder(array.dtype.byteorder))
        if (codes > sys.maxunicode).any():
            raise self._error(name, "text", f"{int(codes.max()):#x}, which is no character")
        texts = tuple(str(text) for text in array)
        if not all(text.strip() and text.isprintable() for text in texts):
            raise self._error(
                name, "printable names", repr(next(t for t in texts if not (t.strip() and t.isprintable())))[:80]
            )
        return texts

    def numbers(self, name: str, shape: tuple[int, ...], kinds: str = "fiu") -> F64:
        """Finite numbers of a shape, in which -1 is any length."""
        most = 8 * math.prod(length if length >= 0 else MAX_FRAMES for length in shape)
        array = self._array(name, kinds, min(most, _MAX_BYTES), shape)
        with np.errstate(invalid="ignore"):  # signalling NaN
            values = array.astype(np.float64)
            inside = np.abs(values) <= _MAX_MAGNITUDE  # NaN compares false
        if not inside.all():
            where = np.unravel_index(int(np.argmin(inside)), inside.shape)
            found = f"{values[where]} at {[int(k) for k in where]}"
            raise self._error(name, f"finite numbers up to {_MAX_MAGNITUDE:.0e}", found)
        return values

    def indices(self, name: str, count: int) -> I64:
        """Whole numbers (count,), of any count for -1."""
        values = self.numbers(name, (count,), "iu")
        return values.astype(np.int64)

    def rate(self) -> float:
        """Frames per second."""
        array = self._array("fps", "fiu", 64)
        fps = float(array.reshape(-1)[0]) if array.size == 1 else math.nan
        if not _FPS[0] <= fps <= _FPS[1]:
            raise self._error(
                "fps", f"one number from {_FPS[0]:.3g} to {_FPS[1]:g}", f"{array.reshape(-1)[:4].tolist()}"
            )
        return fps

    def rotations(self, frames: int, joints: int) -> F64:
        """Local rotations (F, J, 4)."""
        given = [name for name in ("rotations", "rotation_matrices") if name in self]
        if len(given) != 1:
            raise self._error(
                "rotations", "either 'rotations' or 'rotation_matrices'", " and ".join(given) or "neither"
            )
        if given == ["rotations"]:
            values = self.numbers("rotations", (frames, joints, 4))
            lengths = np.linalg.norm(values, axis=-1)
            self._check("rotations", "unit quaternions x, y, z, w", np.abs(lengths - 1.0), lengths)
            return quat.normalize(values)
        matrices = self.numbers("rotation_matrices", (frames, joints, 3, 3))
        products = np.einsum("fjba,fjbc->fjac", matrices, matrices) - np.eye(3)
        bends = np.abs(products).max(axis=(2, 3))
        self._check("rotation_matrices", "rotation matrices without scale and shear", bends, bends)
        determinants = np.linalg.det(matrices)
        self._check("rotation_matrices", "rotation matrices that do not mirror", 1.0 - determinants, determinants)
        return _from_matrices(matrices)

    def _check(self, name: str, expected: str, gaps: F64, shown: F64) -> None:
        if (gaps > _ORTHOGONAL).any():
            frame, joint = np.unravel_index(int(np.argmax(gaps)), gaps.shape)
            found = f"{shown[frame, joint]:.3g} at frame {frame}, joint {joint}"
            raise self._error(name, expected, found, "normalise the rotations before saving")

    def contacts(self, frames: int) -> Marks | None:
        """Contacts, where there are any."""
        if "contacts" not in self:
            return None
        names = self.names("contact_names", MAX_JOINTS)
        return Marks(names, self.numbers("contacts", (frames, len(names)), "fiub"))

    def _array(self, name: str, kinds: str, most: int, wanted: tuple[int, ...] | None = None) -> Array:
        """An array whose type is one of ``kinds``, of at most ``most`` bytes and of the shape that is wanted."""
        row = self._rows.get(name)
        if row is None:
            listed = ", ".join(sorted(self._rows)[:12]) or "none"
            raise self._error(name, f"an array '{name}'", f"the arrays {listed}", "see the layout in docs/source.md")
        if row.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are unpacked as a whole
            raise self._error(
                name, "stored or deflated data", f"compression {row.compress_type}", "save it by numpy.savez"
            )
        try:
            with self._archive.open(row) as file:
                head = file.read(_MAX_HEADER + 16)
                shape, order, dtype, start = _header(head)
                size = math.prod(shape) * dtype.itemsize
                if dtype.kind not in kinds or not 0 < dtype.itemsize <= 4 * MAX_NAME:
                    raise self._error(name, f"an array of {_KINDS[kinds[0]]}", f"type {dtype.str}")
                if wanted is not None and not _fits(shape, wanted):
                    raise self._error(name, f"shape {str(wanted).replace('-1', 'any')}", f"shape {shape}")
                if size > most or start + size > row.file_size:
                    found = f"{size} bytes for shape {shape} of {dtype.str}"
                    raise self._error(name, f"at most {min(most, row.file_size - start)} bytes", found)
                content = head[start:] + file.read(max(start + size - len(head), 0))
        except _BROKEN as err:
            raise self._error(name, "a plain .npy array", f"{err}"[:200], "save it by numpy.savez") from err
        if len(content) < size:
            raise self._error(name, f"{size} bytes", f"{len(content)} bytes", "the file is cut; save it again")
        return np.frombuffer(content, dtype, math.prod(shape)).reshape(shape, order=order)


_KINDS = {"U": "text", "f": "numbers", "i": "whole numbers"}

_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,  # invalid compressed data
    NotImplementedError,  # an unknown compression
    RuntimeError,  # an encrypted file
    EOFError,
    OSError,
    struct.error,
    ValueError,
    TypeError,
)
"""What :mod:`zipfile` and the parser of headers raise for files that they cannot read."""

_HEADER = re.compile(rb"\x93NUMPY[\x01-\x03]\x00")
_DESCR = r"'descr': *'([<>|=]?(?:f[248]|[iu][1248]|b1|U\d{1,4}))'"
_ORDER = r"'fortran_order': *(True|False)"
_SHAPE = r"'shape': *\(((?:\d{1,12}+[, ]*+)*+)\)"  # possessive, so that no header makes it backtrack


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether a shape is the one that is wanted, in which -1 is any length."""
    return len(shape) == len(wanted) and all(b in (-1, a) for a, b in zip(shape, wanted, strict=True))


def _header(head: bytes) -> tuple[tuple[int, ...], Any, np.dtype[Any], int]:
    """Shape, order, type and place of the data of a ``.npy`` file, from its first bytes.

    Source: NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays".
    """
    if not _HEADER.match(head) or len(head) < 10 + 2 * (head[6] > 1):
        raise ValueError("it does not begin as an .npy file")
    wide = head[6] > 1
    length = struct.unpack_from("<I" if wide else "<H", head, 8)[0]
    start = (12 if wide else 10) + length
    if start > min(len(head), _MAX_HEADER):
        raise ValueError(f"a header of {length} bytes")
    text = head[start - length : start].decode("latin-1")
    found = [re.search(pattern, text) for pattern in (_DESCR, _ORDER, _SHAPE)]
    code, order, numbers = (match[1] if match else "" for match in found)
    shape = tuple(int(word) for word in numbers.replace(",", " ").split())
    if not code or not order or found[2] is None or len(shape) > 4:
        raise ValueError(f"the header {text[:80].strip()!r}, not one of plain numbers or text")
    return shape, "F" if order == "True" else "C", np.dtype(code), start


def _from_matrices(matrices: F64) -> F64:
    """Unit quaternions (..., 4) of rotation matrices (..., 3, 3), by the largest of four components.

    Source: S. W. Shepperd, "Quaternion from Rotation Matrix", 1978.
    """
    m = matrices
    diagonal = np.stack([m[..., k, k] for k in range(3)], axis=-1)
    trace = diagonal.sum(axis=-1)
    sizes = np.concatenate([2.0 * diagonal - trace[..., None], trace[..., None]], axis=-1)  # 4 q² - 1 of each component
    differences = [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]]
    sums = [m[..., 1, 2] + m[..., 2, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 0, 1] + m[..., 1, 0]]
    rows = [
        [sizes[..., 0] + 1.0, sums[2], sums[1], differences[0]],
        [sums[2], sizes[..., 1] + 1.0, sums[0], differences[1]],
        [sums[1], sums[0], sizes[..., 2] + 1.0, differences[2]],
        [differences[0], differences[1], differences[2], sizes[..., 3] + 1.0],
    ]
    table = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    best = np.argmax(sizes, axis=-1)[..., None, None]
    return quat.normalize(np.take_along_axis(table, best, axis=-2)[..., 0, :])
