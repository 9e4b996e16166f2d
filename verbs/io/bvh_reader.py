"""The parser of :mod:`verbs.io.bvh`: BVH text in, a checked Motion out.

Three steps: the header by statements, the motion block as one table, the table through the header's channels.
"""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field

import numpy as np

from verbs.conventions import F64, MAX_FRAMES, MAX_JOINTS
from verbs.errors import MotionFileError
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["FRAME_TIME_S", "MAX_STATEMENT", "frame_rate", "motion_from_text"]

_CHANNELS = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
_CHANNEL_INDEX = {name.lower(): index for index, name in enumerate(_CHANNELS)}

# A brace, or all text of a line up to the next brace. Possessive, so that no input makes it backtrack.
_STATEMENT = re.compile(r"\s*+([{}]|[^\n{}]++)")
_ROW = re.compile(r"\s*+([^\n]++)")
_NUMBER = re.compile(r"[+-]?(\d++(\.\d*+)?|\.\d++)([eE][+-]?\d++)?", re.ASCII)
_FRAMES = re.compile(r"frames\s*:\s*(\d{1,9})", re.ASCII | re.IGNORECASE)
_FRAME_TIME = re.compile(r"frame\s+time\s*:\s*(\S+)", re.IGNORECASE)

MAX_STATEMENT = 1_000  # characters; far above any real joint name or channel list
_MAX_VALUE = 1e9  # larger numbers are not lengths or angles, and their squares could overflow
_MAX_ROTATIONS = 20_000_000  # frames × joints: 640 MB of quaternions, which a small hostile file could declare
FRAME_TIME_S = (1e-6, 60.0)
_STILL_M = 1e-6


@dataclass(slots=True)
class _Joint:
    """A joint as its header block describes it; ``channels`` are indices into ``_CHANNELS``."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[int] | None = None


@dataclass(slots=True)
class _Header:
    """Joints, tips as (joint, offset), and the line of each joint's name; all in file order."""

    joints: list[_Joint] = field(default_factory=list)
    lines: dict[str, int] = field(default_factory=dict)
    tips: list[tuple[int, list[float]]] = field(default_factory=list)


class _Text:
    """The text of one file, consumed statement by statement; ``line`` is that of the last one taken."""

    def __init__(self, text: str, path: str) -> None:
        self.text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
        self.path, self.position, self.line = path, 0, 1

    def error(self, expected: str, found: str, line: int | None = None) -> MotionFileError:
        """Build the error for the current line, or for another one."""
        return MotionFileError(self.path, line or self.line, expected, found)

    def take(self, pattern: re.Pattern[str] = _STATEMENT) -> str:
        """Next statement without the space around it; empty at the end of the file."""
        match = pattern.match(self.text, self.position)
        if match is None:
            return ""
        self.line += self.text.count("\n", self.position, match.start(1))
        self.position = match.end()
        if pattern is _STATEMENT and match.end() - match.start(1) > MAX_STATEMENT:
            raise self.error(f"at most {MAX_STATEMENT} characters on a header line", "more")
        return match[1].rstrip()

    def number(self, token: str) -> float:
        """One decimal number; Python's float alone would also take ``nan``, ``1_0`` and other digits."""
        value = float(token) if _NUMBER.fullmatch(token) else np.nan
        if not abs(value) <= _MAX_VALUE:
            raise self.error(f"a number between -{_MAX_VALUE:.0e} and {_MAX_VALUE:.0e}", _shown(token))
        return value


def motion_from_text(text: str, path: str, metres_per_unit: float) -> Motion:
    """Read a motion from BVH text; errors call it ``path``.

    Raises
    ------
    MotionFileError
        If the text is not a strictly valid BVH file.
    """
    source = _Text(text, path)
    header = _read_header(source)
    fps, table = _read_motion(source, header)
    return _to_motion(source, header, fps, table, metres_per_unit)


def frame_rate(frame_time_s: float) -> float:
    """Rate of a rounded frame time: the nearest whole number, or whole number / 1.001, if near enough."""
    exact = 1.0 / frame_time_s
    candidates = [max(round(exact * scale), 1) / scale for scale in (1.0, 1.001)]
    nearest = min(candidates, key=lambda rate: abs(rate - exact))
    # 0.016667 stands for 1/60 with an error of 2e-5, 0.008333 for 1/120 and 4e-5; 60 and 59.94 fps are 1e-3 apart.
    return nearest if abs(nearest * frame_time_s - 1.0) <= 5e-5 else exact


def _shown(text: str) -> str:
    """Quote the start of what was found."""
    return repr(text if len(text) <= 40 else text[:40] + "…") if text else "the end of the file"


def _keyword(statement: str) -> tuple[str, str]:
    """First word in capitals, and the rest."""
    words = statement.split(None, 1)
    return words[0].upper() if words else "", words[1] if len(words) > 1 else ""


def _expect(source: _Text, keyword: str, expected: str) -> None:
    """Take one statement, which must be this word."""
    statement = source.take()
    if statement.upper() != keyword:
        raise source.error(expected, _shown(statement))


def _read_header(source: _Text) -> _Header:
    """Everything up to and including MOTION. Open blocks are a list, so that depth is no limit."""
    header = _Header()
    _expect(source, "HIERARCHY", "HIERARCHY")
    statement = source.take()
    keyword, name = _keyword(statement)
    if keyword != "ROOT":
        raise source.error("ROOT and a name", _shown(statement))
    blocks = [_open_joint(source, header, name, -1)]
    while blocks:
        joint = header.joints[blocks[-1]]
        statement = source.take()
        keyword, rest = _keyword(statement)
        complete = bool(joint.offset) and joint.channels is not None
        if keyword == "OFFSET" and not joint.offset:
            joint.offset = _offset(source, rest)
        elif keyword == "CHANNELS" and joint.channels is None:
            joint.channels = _channels(source, joint.name, rest)
        elif keyword == "JOINT" and complete:
            blocks.append(_open_joint(source, header, rest, blocks[-1]))
        elif keyword == "END" and rest.upper() == "SITE" and complete:
            header.tips.append((blocks[-1], _tip(source, header)))
        elif keyword == "}" and complete:
            blocks.pop()
        else:
            known = "JOINT, End Site or '}'" if complete else "OFFSET and CHANNELS, once each,"
            raise source.error(f"{known} in joint '{joint.name}'", _shown(statement))
    _expect(source, "MOTION", "MOTION after the one ROOT block")
    return header


def _open_joint(source: _Text, header: _Header, name: str, parent: int) -> int:
    """Append a joint whose keyword was just taken, and step into its block; returns its index."""
    if not name:
        raise source.error("a joint name", "the end of the line")
    if len(header.joints) == MAX_JOINTS:
        raise source.error(f"at most {MAX_JOINTS} joints", f"another joint, {_shown(name)}")
    if name in header.lines:
        raise source.error("joint names that differ", f"{_shown(name)} again, first on line {header.lines[name]}")
    header.lines[name] = source.line
    header.joints.append(_Joint(name, parent))
    _expect(source, "{", f"'{{' after joint {_shown(name)}")
    return len(header.joints) - 1


def _offset(source: _Text, rest: str) -> list[float]:
    words = rest.split()
    if len(words) != 3:
        raise source.error("3 numbers after OFFSET", str(len(words)))
    return [source.number(word) for word in words]


def _channels(source: _Text, name: str, rest: str) -> list[int]:
    """Channel indices of one joint in file order."""
    count, *words = rest.split() or [""]
    if count not in set("0123456"):
        raise source.error("a number from 0 to 6 after CHANNELS", _shown(count) if count else "nothing")
    if len(words) != int(count):
        raise source.error(f"{count} channel names on joint '{name}'", str(len(words)))
    channels: list[int] = []
    for word in words:
        index = _CHANNEL_INDEX.get(word.lower())
        if index is None:
            raise source.error(f"one of {', '.join(_CHANNELS)}", _shown(word))
        if index in channels:
            raise source.error(f"each channel once on joint '{name}'", f"{_CHANNELS[index]} twice")
        channels.append(index)
    return channels


def _tip(source: _Text, header: _Header) -> list[float]:
    """Offset of an End Site whose keyword was just taken."""
    if len(header.tips) == MAX_JOINTS:
        raise source.error(f"at most {MAX_JOINTS} End Sites", "another one")
    _expect(source, "{", "'{' after End Site")
    statement = source.take()
    keyword, rest = _keyword(statement)
    if keyword != "OFFSET":
        raise source.error("OFFSET of the End Site", _shown(statement))
    offset = _offset(source, rest)
    _expect(source, "}", "'}' after the End Site's OFFSET")
    return offset


def _read_motion(source: _Text, header: _Header) -> tuple[float, F64]:
    """Frames per second, and the table (frames, channels) in the file's units."""
    statement = source.take()
    match = _FRAMES.fullmatch(statement)
    if match is None:
        raise source.error("'Frames:' and a whole number", _shown(statement))
    frames, frames_line = int(match[1]), source.line
    if not 1 <= frames <= MAX_FRAMES:
        raise source.error(f"1 to {MAX_FRAMES} frames", str(frames))
    if frames * len(header.joints) > _MAX_ROTATIONS:
        raise source.error(f"at most {_MAX_ROTATIONS} frames × joints", f"{frames} × {len(header.joints)}")
    statement = source.take()
    match = _FRAME_TIME.fullmatch(statement)
    if match is None:
        raise source.error("'Frame Time:' and seconds", _shown(statement))
    frame_time_s = source.number(match[1])
    if not FRAME_TIME_S[0] <= frame_time_s <= FRAME_TIME_S[1]:
        raise source.error(f"a frame time of {FRAME_TIME_S[0]} to {FRAME_TIME_S[1]} s", match[1])
    columns = sum(len(joint.channels or ()) for joint in header.joints)
    if columns == 0:
        raise source.error("at least one channel in the header", "none")
    start = source.position, source.line
    table = _quick_table(source, frames, columns)
    if table is None:
        source.position, source.line = start
        table = _careful_table(source, frames, columns, frames_line)
    return frame_rate(frame_time_s), table


def _quick_table(source: _Text, frames: int, columns: int) -> F64 | None:
    """All rows at once; None where anything is unusual, for the slow reader to report it with its line."""
    rest = source.text[source.position :]
    if "_" in rest or not rest.isascii():  # Python's float takes 1_0 and the digits of other scripts
        return None
    values = array("d")  # grows with what is there, not with what the file claims
    try:
        while row := source.take(_ROW):
            words = row.split(None, columns)
            if len(words) != columns or len(values) == frames * columns:
                return None
            values.extend(map(float, words))
    except ValueError:
        return None
    if len(values) != frames * columns:
        return None
    table = np.frombuffer(values, np.float64).reshape(frames, columns)
    # Written so that NaN, for which comparisons are false, is refused too.
    return table if table.min() >= -_MAX_VALUE and table.max() <= _MAX_VALUE else None


def _careful_table(source: _Text, frames: int, columns: int, frames_line: int) -> F64:
    """Row by row: errors name the first wrong line."""
    values, rows = array("d"), 0
    while row := source.take(_ROW):
        if rows == frames:
            found = f"another row, {_shown(row)}"
            raise source.error(f"the end after {frames} rows (Frames: on line {frames_line})", found)
        words = row.split(None, columns)
        if len(words) != columns:
            count = len(row.split(None, 2 * columns))  # a hostile row could hold millions
            raise source.error(f"{columns} values", str(count) if count <= 2 * columns else "far more")
        values.extend(map(source.number, words))
        rows += 1
    if rows < frames:
        raise source.error(f"{frames} rows of values to follow", f"{rows} rows", frames_line)
    return np.frombuffer(values, np.float64).reshape(frames, columns)


def _to_motion(source: _Text, header: _Header, fps: float, table: F64, scale: float) -> Motion:
    """Apply every joint's channels to the table."""
    offsets = scale * np.array([joint.offset for joint in header.joints])
    rotations = np.zeros((len(table), len(offsets), 4))
    rotations[..., 3] = 1.0
    root = np.tile(offsets[0], (len(table), 1))
    turning: dict[str, list[tuple[int, list[int]]]] = {}
    column = 0
    for index, joint in enumerate(header.joints):
        channels = {channel: column + place for place, channel in enumerate(joint.channels or ())}
        column += len(channels)
        order = "".join("XYZ"[channel - 3] for channel in channels if channel >= 3)
        if order:
            turning.setdefault(order, []).append((index, [channels["XYZ".index(axis) + 3] for axis in order]))
        axes = [channel for channel in channels if channel < 3]
        positions = scale * table[:, [channels[axis] for axis in axes]]
        if index == 0:
            root[:, axes] = positions
        elif axes:
            if (spread := float(np.ptp(positions, axis=0).max())) > _STILL_M:
                expected = f"constant position channels on joint '{joint.name}' (only the root may move)"
                raise source.error(expected, f"they vary by {spread:.6g} m", header.lines[joint.name])
            offsets[index, axes] = positions[0]
    for order, joints in turning.items():  # all joints of an order in one call; in blocks, to bound memory
        indices, columns = [index for index, _ in joints], [columns for _, columns in joints]
        for block in (slice(start, start + 1024) for start in range(0, len(table), 1024)):
            rotations[block, indices] = quat.from_euler(order, np.radians(table[block][:, columns]))
    offsets[0] = 0.0
    parents = np.array([joint.parent for joint in header.joints], np.int64)
    tip_parents = np.array([joint for joint, _ in header.tips], np.int64)
    tip_offsets = scale * np.array([offset for _, offset in header.tips]).reshape(-1, 3)
    names = tuple(joint.name for joint in header.joints)
    return Motion(Skeleton(names, parents, offsets, tip_parents, tip_offsets), fps, root, rotations)
