"""Strict BVH reader and writer: invalid files are refused with their line.

Decisions where the format is ambiguous:

- Each joint has its own channel order; rotation channels apply from left to right (R = first · second ·
  third). There are one to three of them; a missing axis has angle 0. The order of
  position channels among them has no meaning.
- A position channel *replaces* that component of the joint's OFFSET, as in pymotion and most other tools.
  Other joints than the root may have them: see :mod:`verbs.io.joint_tracks`.
- Of several hierarchies the one with the most joints is read. Channels of an End Site have columns and no effect.
- A root without position channels stands at its OFFSET. ``Skeleton.offsets[0]`` is always zero.
- Every End Site becomes a tip. The writer gives a leaf joint without a tip an End Site of zero length, since
  the format asks for one; reading that file back adds the tip.
- A rate next to a whole number, or to a whole number / 1.001, is that number: ``0.03333333`` s are 30 fps.
- A joint's name is the rest of its line: ``mixamorig:Hips`` and ``Left Arm`` are valid.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, MAX_FILE_BYTES, METRES_PER_UNIT
from verbs.errors import MotionFileError, OutOfRange, UnknownName
from verbs.io.bvh_reader import FRAME_TIME_S, MAX_STATEMENT, frame_rate, tracks_from_text
from verbs.io.files import file_content, write_atomically
from verbs.io.joint_tracks import STRETCH_M, root_motion
from verbs.io.report import MotionFile, Report
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["dump", "parse", "parse_file", "read", "read_file", "write"]

_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_NAME = re.compile(r"[^\s{}]([^\r\n{}]*[^\s{}])?")
_LOCKED = 1e-9  # sine below which Euler angles count as locked; rounding noise is 1e-16


def read(path: str | Path, *, unit: str = "m", root: str | None = None, stretch_m: float = STRETCH_M) -> Motion:
    """Read the motion of a BVH file; the rest is as in :func:`read_file`."""
    return read_file(path, unit=unit, root=root, stretch_m=stretch_m).motion


def read_file(
    path: str | Path, *, unit: str = "m", root: str | None = None, stretch_m: float = STRETCH_M
) -> MotionFile:
    """Read a BVH file, with a report.

    Parameters
    ----------
    path : str or Path
        A regular file of UTF-8 text, at most ``conventions.MAX_FILE_BYTES`` long.
    unit : str
        The file's unit of length, a key of ``conventions.METRES_PER_UNIT``; BVH files do not state it.
    root : str, optional
        Joint that becomes the root of the motion; those above it are folded into it. See
        :func:`verbs.io.joint_tracks.root_motion` for the default.
    stretch_m : float
        Largest distance of a joint from its mean offset that is dropped, metres.

    Returns
    -------
    file : MotionFile
        The motion, in metres, and the report.

    Raises
    ------
    MotionFileError
        If the file cannot be read or is not strictly valid; with line, expected and found.
    UnknownName
        If the unit is not known.
    """
    content = file_content(path)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as err:
        line = content.count(b"\n", 0, err.start) + 1
        raise MotionFileError(path, line, "UTF-8 text", f"byte 0x{content[err.start]:02x}") from err
    return parse_file(text, name=str(path), unit=unit, root=root, stretch_m=stretch_m)


def parse(
    text: str, *, name: str = "<text>", unit: str = "m", root: str | None = None, stretch_m: float = STRETCH_M
) -> Motion:
    """Read a motion from BVH text; errors call it ``name``; the rest is as in :func:`read_file`.

    Raises
    ------
    MotionFileError
        If the text is not a strictly valid BVH file.
    UnknownName
        If the unit is not known.
    """
    return parse_file(text, name=name, unit=unit, root=root, stretch_m=stretch_m).motion


def parse_file(
    text: str, *, name: str = "<text>", unit: str = "m", root: str | None = None, stretch_m: float = STRETCH_M
) -> MotionFile:
    """Read a motion and its report from BVH text; the rest is as in :func:`parse`."""
    if unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    if len(text) > MAX_FILE_BYTES:
        raise MotionFileError(name, None, f"at most {MAX_FILE_BYTES} bytes", f"{len(text)} characters")
    tracks, ignored = tracks_from_text(text, name, METRES_PER_UNIT[unit], root)
    motion, notes, folded = root_motion(tracks, name, root=root, stretch_m=stretch_m)
    return MotionFile(motion, Report("bvh", (*ignored, *notes), folded))


def dump(motion: Motion, *, order: str = "ZXY", decimals: int = 6) -> str:
    """Write a motion as BVH text, in metres and degrees; equal motions give equal text.

    Euler angles are continuous over time, through gimbal lock too, so that they can be edited as curves.

    Parameters
    ----------
    motion : Motion
        What to write.
    order : str
        Rotation order of every joint, a permutation of ``"XYZ"``.
    decimals : int
        Digits after the point of lengths and angles, 1 to 12.

    Raises
    ------
    UnknownName
        If the order is not known.
    OutOfRange
        If ``decimals`` or the motion's rate is out of range.
    MotionFileError
        If a joint's name cannot stand in a BVH file.
    """
    _check_writable(motion, order, decimals)
    lines, joints = _header_lines(motion.skeleton, order, decimals)
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {_frame_time(motion.fps)}"]
    angles = np.degrees(_continuous_euler(order, motion.rotations[:, joints]))
    table = np.concatenate([motion.root, angles.reshape(len(motion), -1)], axis=1)
    row_format = " ".join([f"%.{decimals}f"] * table.shape[1])
    # Rounding first and adding zero turns -0.000000 into 0.000000.
    lines += [row_format % tuple(row) for row in (np.round(table, decimals) + 0.0).tolist()]
    return "\n".join(lines) + "\n"


def write(motion: Motion, path: str | Path, *, order: str = "ZXY", decimals: int = 6) -> None:
    """Write a motion to a BVH file, atomically; the parameters are those of :func:`dump`.

    Raises
    ------
    MotionFileError
        If the file cannot be written; and what :func:`dump` raises.
    """
    text = dump(motion, order=order, decimals=decimals)
    try:
        content = text.encode()
    except UnicodeEncodeError as err:  # half a surrogate in a name
        raise MotionFileError(path, None, "a file that can be written", str(err)) from err
    write_atomically(path, content)


def _check_writable(motion: Motion, order: str, decimals: int) -> None:
    if order not in _ORDERS:
        raise UnknownName("rotation order", order, _ORDERS)
    if not 1 <= decimals <= 12:
        raise OutOfRange(f"decimals must be 1 to 12, not {decimals}")
    shortest, longest = FRAME_TIME_S
    if not shortest <= 1.0 / motion.fps <= longest:
        raise OutOfRange(f"a BVH file's rate is {1.0 / longest:.4f} to {1.0 / shortest:.0f} fps, not {motion.fps}")
    for name in motion.skeleton.names:
        if len(f"JOINT {name}") > MAX_STATEMENT or not _NAME.fullmatch(name):
            raise MotionFileError("<text>", None, "a joint name of one line without braces", repr(name[:40]))


def _header_lines(skeleton: Skeleton, order: str, decimals: int) -> tuple[list[str], list[int]]:
    """Lines of the HIERARCHY, and joints in the order in which it names them (depth first)."""
    children: list[list[int]] = [[] for _ in skeleton.names]
    tips: list[list[F64]] = [[] for _ in skeleton.names]
    for joint, parent in enumerate(skeleton.parents.tolist()[1:], start=1):
        children[parent].append(joint)
    for parent, offset in zip(skeleton.tip_parents.tolist(), skeleton.tip_offsets, strict=True):
        tips[parent].append(offset)

    def placed(offset: F64) -> str:
        return "OFFSET " + " ".join(f"{value:.{decimals}f}" for value in np.round(offset, decimals) + 0.0)

    channels = " ".join(f"{axis}rotation" for axis in order)
    lines, joints, waiting = ["HIERARCHY"], [], [(0, 0)]
    while waiting:
        joint, depth = waiting.pop()
        tab = "\t" * depth
        if joint < 0:
            lines.append(tab + "}")
            continue
        joints.append(joint)
        lines += [f"{tab}{'JOINT' if joint else 'ROOT'} {skeleton.names[joint]}", tab + "{"]
        lines.append(f"{tab}\t{placed(skeleton.offsets[joint] * (joint > 0))}")
        count = "3" if joint else "6 Xposition Yposition Zposition"
        lines.append(f"{tab}\tCHANNELS {count} {channels}")
        for offset in tips[joint] or ([] if children[joint] else [np.zeros(3)]):
            lines += [f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\t{placed(offset)}", f"{tab}\t}}"]
        waiting.append((-1, depth))
        waiting += [(child, depth + 1) for child in reversed(children[joint])]
    return lines, joints


def _frame_time(fps: float) -> str:
    """Seconds per frame with as many digits, at least 8, as the exact rate needs."""
    text = ""
    for digits in range(8, 25):
        text = f"{1.0 / fps:.{digits}f}"
        if frame_rate(float(text)) == fps:
            break
    return text


def _continuous_euler(order: str, rotations: F64) -> F64:
    """Euler angles (F, J, 3), radians, each as near to its previous frame as the rotation allows.

    Half the sum and half the difference of the outer angles come straight from the quaternion. At gimbal lock
    one of the two is undefined: it keeps its last value, and the rotation stays exact.

    Source: E. Bernardes and S. Viollet, "Quaternion to Euler angles conversion: A direct, general and
    computationally efficient method", 2022; here for intrinsic orders of three different axes.
    """
    first, middle, last = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (middle - first) % 3 == 1 else -1.0
    smooth = quat.unroll(quat.normalize(rotations))
    x, y, z = (sign * smooth[..., axis] for axis in (first, middle, last))
    w = smooth[..., 3]
    plus, minus = np.hypot(x + z, w + y), np.hypot(x - z, w - y)
    half_sum = _held(np.arctan2(x + z, w + y), plus > _LOCKED)
    half_difference = _held(np.arctan2(x - z, w - y), minus > _LOCKED)
    bend = 0.5 * np.pi - 2.0 * np.arctan2(minus, plus)
    angles = sign * np.stack([half_sum + half_difference, bend, half_sum - half_difference], axis=-1)
    # (a + π, π - b, c + π) is the same rotation. Which of the two is nearer to the previous frame depends
    # only on whether that frame was swapped, so the choices are a running parity.
    swapped = angles * [1.0, -1.0, 1.0] + np.pi
    stay = np.sum(_wrapped(angles[1:] - angles[:-1]) ** 2, axis=-1)
    swap = np.sum(_wrapped(swapped[1:] - angles[:-1]) ** 2, axis=-1)
    odd = np.cumsum(swap < stay, axis=0) % 2 == 1
    angles[1:] = np.where(odd[..., None], swapped[1:], angles[1:])
    return np.unwrap(_wrapped(angles), axis=0)


def _held(values: F64, known: npt.NDArray[np.bool_]) -> F64:
    """Values (F, J) where an unknown one repeats the last known one of its joint."""
    rows = np.where(known, np.arange(len(values))[:, None], 0)
    return np.take_along_axis(values, np.maximum.accumulate(rows, axis=0), axis=0)


def _wrapped(angles: F64) -> F64:
    """Angles in [-π, π)."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
