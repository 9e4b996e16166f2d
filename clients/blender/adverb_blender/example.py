"""Examples of a verb source (docs/source.md): a BVH file, and its lines of verb.toml."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .coordinates import Quaternion, Vector, multiply, rotate, zxy

__all__ = ["Clip", "bvh", "example_lines", "keytimes_of", "positions", "save_example", "stale_markers"]

Numbers = Sequence[float]


@dataclass(frozen=True)
class Clip:
    """A motion in the server's axes.

    Parameters
    ----------
    names : list of str
        Joints, the root first, parents before children.
    parents : list of int
        -1 for the root.
    offsets : list of 3 numbers
        At rest, in the parent's frame, m.
    fps : float
    roots : list of 3 numbers
        Position of the root per frame, m.
    rotations : list of lists of 4 numbers
        Local x, y, z, w of each joint per frame.
    """

    names: list[str]
    parents: list[int]
    offsets: list[Vector]
    fps: float
    roots: list[Vector]
    rotations: list[list[Quaternion]]


def positions(clip: Clip, frame: int) -> list[Vector]:
    """Joint positions of a frame, m."""
    global_rotations: list[Quaternion] = []
    found: list[Vector] = []
    for joint, parent in enumerate(clip.parents):
        local = clip.rotations[frame][joint]
        if parent < 0:
            global_rotations.append(local)
            found.append(clip.roots[frame])
            continue
        global_rotations.append(multiply(global_rotations[parent], local))
        x, y, z = rotate(global_rotations[parent], clip.offsets[joint])
        found.append((found[parent][0] + x, found[parent][1] + y, found[parent][2] + z))
    return found


def bvh(clip: Clip) -> str:
    """Text of a BVH file in metres."""
    lines = ["HIERARCHY"]
    order = _write_joint(clip, 0, 0, lines)
    lines += ["MOTION", f"Frames: {len(clip.roots)}", f"Frame Time: {1.0 / clip.fps:.9f}"]
    for root, local in zip(clip.roots, clip.rotations, strict=True):
        numbers = [*root, *(angle for joint in order for angle in zxy(local[joint]))]
        lines.append(" ".join(f"{number:.7f}" for number in numbers))
    return "\n".join(lines) + "\n"


def _write_joint(clip: Clip, joint: int, depth: int, lines: list[str]) -> list[int]:
    """Write a joint and those below; returns them in the order of their channels."""
    pad, root = "  " * depth, clip.parents[joint] < 0
    lines.append(f"{pad}{'ROOT' if root else 'JOINT'} {clip.names[joint]}")
    lines.append(f"{pad}{{")
    offset = (0.0, 0.0, 0.0) if root else clip.offsets[joint]
    lines.append(f"{pad}  OFFSET " + " ".join(f"{value:.7f}" for value in offset))
    moves = "6 Xposition Yposition Zposition" if root else "3"
    lines.append(f"{pad}  CHANNELS {moves} Zrotation Xrotation Yrotation")
    order = [joint]
    children = [child for child, parent in enumerate(clip.parents) if parent == joint]
    for child in children:
        order += _write_joint(clip, child, depth + 1, lines)
    if not children:
        lines += [f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET 0.0 0.0 0.0", f"{pad}  }}"]
    lines.append(f"{pad}}}")
    return order


def keytimes_of(markers: Sequence[tuple[str, float]], start: float, fps: float) -> list[float]:
    """Seconds of timeline markers (name, frame) from the first frame, in order.

    Raises
    ------
    ValueError
        If there are fewer than two, one is before the first frame, or two are at the same frame.
    """
    frames = sorted(frame for _, frame in markers)
    if len(frames) < 2:
        raise ValueError("set a timeline marker at each keytime: at least at the start and at the end")
    if frames[0] < start:
        raise ValueError(f"the marker at frame {frames[0]:g} is before the first frame {start:g}")
    if len(set(frames)) < len(frames):
        raise ValueError("two timeline markers are at the same frame")
    return [round((frame - start) / fps, 6) for frame in frames]


def stale_markers(markers: Sequence[tuple[str, float]], names: Sequence[str], start: float) -> list[int]:
    """Indices of the markers of an earlier motion from the same frame: up to the next marker of the first name."""
    end = min((frame for name, frame in markers if name == names[0] and frame > start), default=math.inf)
    return [k for k, (name, frame) in enumerate(markers) if name in names and start <= frame < end]


def example_lines(file: str, keytimes: Numbers, adverbs: Numbers) -> str:
    """The table ``[[example]]`` of verb.toml."""
    times = ", ".join(repr(float(value)) for value in keytimes)
    values = ", ".join(repr(round(float(value), 6)) for value in adverbs)
    return f"\n[[example]]\nfile = {json.dumps(file)}\nkeytimes = [{times}]\nadverb_values = [{values}]\n"


def save_example(folder: Path, name: str, clip: Clip, keytimes: Numbers, adverbs: Numbers) -> Path:
    """Write NAME.bvh, and append its lines to verb.toml of the folder; returns the BVH file.

    Raises
    ------
    ValueError
        If the folder has no verb.toml, or has a file of the name.
    """
    if not (folder / "verb.toml").is_file():
        raise ValueError(f"{folder} has no verb.toml; write its head first, see docs/source.md")
    path = folder / f"{name}.bvh"
    if path.exists():
        raise ValueError(f"{path} exists")
    path.write_text(bvh(clip), encoding="utf-8")
    with (folder / "verb.toml").open("a", encoding="utf-8") as toml:
        toml.write(example_lines(path.name, keytimes, adverbs))
    return path
