"""The parser of :mod:`verbs.io.bvh`: BVH text in, the tracks of all joints out.

Three steps: the header by statements, the motion block as one table, the table through the header's channels.
"""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field

import numpy as np

from verbs.conventions import F64, MAX_FRAMES, MAX_JOINTS
from verbs.errors import MotionFileError
from verbs.io.joint_tracks import JointTracks
from verbs.io.report import Note
from verbs.kernels import quat

__all__ = ["FRAME_TIME_S", "MAX_STATEMENT", "frame_rate", "tracks_from_text"]

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


@dataclass(slots=True)
class _Joint:
    """A joint as its header block describes it; ``channels`` are indices into ``_CHANNELS``, from ``column`` on."""

    name: str
    line: int
    parent: int
    tree: int
    column: int = 0
    offset: list[float] = field(default_factory=list)
    channels: list[int] | None = None


@dataclass(slots=True)
class _Header:
    """Joints of all trees, tips as (joint, offset), in file order; columns of the table; names of this tree's joints.

    ``tip_channels`` are the joints whose End Site has channels.
    """

    joints: list[_Joint] = field(default_factory=list)
    tips: list[tuple[int, list[float]]] = field(default_factory=list)
    trees: int = 0
    columns: int = 0
    lines: dict[str, int] = field(default_factory=dict)
    tip_channels: list[int] = field(default_factory=list)


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


def tracks_from_text(text: str, path: str, metres_per_unit: float, root: str | None) -> tuple[JointTracks, list[Note]]:
    """Read the tracks of one hierarchy from BVH text: the one with a joint ``root``, or with the most joints.

    Raises
    ------
    MotionFileError
        If the text is not a strictly valid BVH file, or two hierarchies are equally large. Errors call it ``path``.
    """
    source = _Text(text, path)
    header = _read_header(source)
    fps, table = _read_motion(source, header)
    tree, notes = _choose_tree(source, header, root)
    return _tracks(header, tree, fps, table, metres_per_unit), notes


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
    """Everything up to and including MOTION."""
    header = _Header()
    _expect(source, "HIERARCHY", "HIERARCHY")
    statement = source.take()
    while True:
        keyword, name = _keyword(statement)
        if keyword != "ROOT":
            known = "MOTION or another ROOT after the ROOT block" if header.trees else "ROOT and a name"
            raise source.error(known, _shown(statement))
        _read_tree(source, header, name)
        statement = source.take()
        if statement.upper() == "MOTION":
            return header


def _read_tree(source: _Text, header: _Header, name: str) -> None:
    """One ROOT block, whose keyword and name were just taken. Open blocks are a list, so that depth is no limit."""
    header.trees += 1
    header.lines = {}
    blocks = [_open_joint(source, header, name, -1)]
    while blocks:
        joint = header.joints[blocks[-1]]
        statement = source.take()
        keyword, rest = _keyword(statement)
        complete = bool(joint.offset) and joint.channels is not None
        if keyword == "OFFSET" and not joint.offset:
            joint.offset = _offset(source, rest)
        elif keyword == "CHANNELS" and joint.channels is None:
            joint.channels, joint.column = _channels(source, joint.name, rest), header.columns
            header.columns += len(joint.channels)
        elif keyword == "JOINT" and complete:
            blocks.append(_open_joint(source, header, rest, blocks[-1]))
        elif keyword == "END" and rest.upper() == "SITE" and complete:
            header.tips.append((blocks[-1], _tip(source, header, blocks[-1])))
        elif keyword == "}" and complete:
            blocks.pop()
        else:
            known = "JOINT, End Site or '}'" if complete else "OFFSET and CHANNELS, once each,"
            raise source.error(f"{known} in joint '{joint.name}'", _shown(statement))


def _open_joint(source: _Text, header: _Header, name: str, parent: int) -> int:
    """Append a joint whose keyword was just taken, and step into its block; returns its index."""
    if not name:
        raise source.error("a joint name", "the end of the line")
    if len(header.joints) == MAX_JOINTS:
        raise source.error(f"at most {MAX_JOINTS} joints", f"another joint, {_shown(name)}")
    if name in header.lines:
        raise source.error("joint names that differ", f"{_shown(name)} again, first on line {header.lines[name]}")
    header.lines[name] = source.line
    header.joints.append(_Joint(name, source.line, parent, header.trees - 1))
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


def _tip(source: _Text, header: _Header, joint: int) -> list[float]:
    """Offset of an End Site whose keyword was just taken; its channels have columns, and no effect."""
    if len(header.tips) == MAX_JOINTS:
        raise source.error(f"at most {MAX_JOINTS} End Sites", "another one")
    _expect(source, "{", "'{' after End Site")
    statement = source.take()
    keyword, rest = _keyword(statement)
    if keyword != "OFFSET":
        raise source.error("OFFSET of the End Site", _shown(statement))
    offset = _offset(source, rest)
    statement = source.take()
    keyword, rest = _keyword(statement)
    if keyword == "CHANNELS":
        header.columns += len(_channels(source, header.joints[joint].name, rest))
        header.tip_channels.append(joint)
        statement = source.take()
    if statement != "}":
        raise source.error("'}' after the End Site's OFFSET", _shown(statement))
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
    columns = header.columns
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


def _choose_tree(source: _Text, header: _Header, root: str | None) -> tuple[int, list[Note]]:
    """Number of the hierarchy to read, and notes on what is ignored."""
    trees: list[list[_Joint]] = [[] for _ in range(header.trees)]
    for joint in header.joints:
        trees[joint.tree].append(joint)
    named = [tree for tree, joints in enumerate(trees) if any(joint.name == root for joint in joints)]
    among = named or list(range(header.trees))
    chosen = max(among, key=lambda tree: len(trees[tree]))
    alike = [trees[tree][0].name for tree in among if len(trees[tree]) == len(trees[chosen])]
    if len(alike) > 1:
        found = f"{len(alike)} hierarchies with {len(trees[chosen])} joints: {', '.join(alike[:5])}"
        advice = "name the root to read (root, in a mapping.toml [root] joint), or put each character into its own file"
        expected = "one hierarchy that is larger than the others"
        raise MotionFileError(source.path, trees[chosen][0].line, expected, found, advice)
    notes = []
    for tree, joints in enumerate(trees):
        if tree != chosen:
            name, count = joints[0].name, len(joints)
            size = f"{count} joint{'s' * (count > 1)}"
            text = f"hierarchy '{name}' with {size} is ignored; '{trees[chosen][0].name}' is read"
            notes.append(Note("ignored_root", name, text, float(count)))
    for index in dict.fromkeys(header.tip_channels):
        name = header.joints[index].name
        if header.joints[index].tree == chosen:
            notes.append(Note("ignored_channels", name, f"channels of the End Site of joint '{name}' are ignored"))
    return chosen, notes


def _tracks(header: _Header, tree: int, fps: float, table: F64, scale: float) -> JointTracks:
    """Apply the channels of one hierarchy's joints to the table."""
    chosen = [index for index, joint in enumerate(header.joints) if joint.tree == tree]
    first = chosen[0]  # the joints of a hierarchy stand in one row
    joints = [header.joints[index] for index in chosen]
    offsets = scale * np.array([joint.offset for joint in joints])
    rotations = np.zeros((len(table), len(joints), 4))
    rotations[..., 3] = 1.0
    positions: dict[int, F64] = {}
    turning: dict[str, list[tuple[int, list[int]]]] = {}
    for index, joint in enumerate(joints):
        channels = {channel: joint.column + place for place, channel in enumerate(joint.channels or ())}
        order = "".join("XYZ"[channel - 3] for channel in channels if channel >= 3)
        if order:
            turning.setdefault(order, []).append((index, [channels["XYZ".index(axis) + 3] for axis in order]))
        axes = [channel for channel in channels if channel < 3]
        if axes:
            positions[index] = np.tile(offsets[index], (len(table), 1))
            positions[index][:, axes] = scale * table[:, [channels[axis] for axis in axes]]
    for order, rows in turning.items():  # all joints of an order in one call; in blocks, to bound memory
        indices, columns = [index for index, _ in rows], [columns for _, columns in rows]
        for block in (slice(start, start + 1024) for start in range(0, len(table), 1024)):
            rotations[block, indices] = quat.from_euler(order, np.radians(table[block][:, columns]))
    tips = [(joint - first, offset) for joint, offset in header.tips if header.joints[joint].tree == tree]
    return JointTracks(
        names=tuple(joint.name for joint in joints),
        parents=np.array([joint.parent - first if joint.parent >= 0 else -1 for joint in joints], np.int64),
        offsets=offsets,
        rotations=rotations,
        positions=positions,
        tip_parents=np.array([joint for joint, _ in tips], np.int64),
        tip_offsets=scale * np.array([offset for _, offset in tips]).reshape(-1, 3),
        fps=fps,
        places=[joint.line for joint in joints],
    )
