"""glTF 2.0 reader: one animation of ``.glb`` or ``.gltf`` to a motion.

Decisions where the format leaves a choice:

- Joints are the nodes that skins use, with those between them; without a skin, animated nodes and all below them.
- Nodes above the root that are fixed, such as one that turns +Z up into +Y up, are applied to the root. Animated ones
  are folded into it; the report keeps their motion. Further joints that move follow :mod:`verbs.io.joint_tracks`.
- A constant scale is applied to what hangs on a joint. A scale that changes is reported and ignored.
- Frames are taken at a fixed rate from the first key on: that of the keys where they lie on a grid, or 60.
- Names that stand twice get a number.

The reader is our own: the part of the format that holds motion is small, bounds and errors with their place are what
matters here, and the packages for Python keep neither.

Source: Khronos, "glTF 2.0 Specification".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from verbs.conventions import F64, MAX_FRAMES, METRES_PER_UNIT
from verbs.errors import MotionFileError, UnknownName
from verbs.io.gltf_accessors import Accessors
from verbs.io.gltf_document import Document, open_document
from verbs.io.gltf_nodes import Joints, Node, choose_joints, read_nodes
from verbs.io.gltf_scales import SCALED, fixed_transform, inherited_scale, node_scale
from verbs.io.gltf_tracks import Track, key_rate, read_tracks, sample
from verbs.io.joint_tracks import STRETCH_M, JointTracks, root_motion
from verbs.io.report import MotionFile, Note, Report
from verbs.kernels import quat

__all__ = ["MAX_FPS", "clip_names", "read_file", "unique_names"]

MAX_FPS = 1000.0
_MAX_ROTATIONS = 20_000_000  # frames × joints, as for BVH

Tracks = dict[tuple[int, str], Track]


def read_file(
    path: str | Path,
    *,
    unit: str = "m",
    root: str | None = None,
    stretch_m: float = STRETCH_M,
    clip: str | int | None = None,
    fps: float | None = None,
) -> MotionFile:
    """Read an animation of a ``.glb`` or ``.gltf`` file.

    Parameters
    ----------
    path : str or Path
    unit : str
        Unit of length, a key of ``conventions.METRES_PER_UNIT``. The format's is the metre; not every file keeps it.
    root : str, optional
        Joint that becomes the root; see :func:`verbs.io.joint_tracks.root_motion`.
    stretch_m : float
        Largest distance of a joint from its mean offset that is dropped, metres.
    clip : str or int, optional
        Name or index of the animation; required where there are several.
    fps : float, optional
        Frames per second to sample at, up to :data:`MAX_FPS`. Default: the rate of the keys, else 60.

    Returns
    -------
    file : MotionFile

    Raises
    ------
    MotionFileError
        The file is invalid, with the place in it.
    UnknownName
        The unit is not known.
    """
    if unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    document = open_document(Path(path))
    number, clips = _choose_clip(document, clip)
    place = f"animations[{number}]"
    tracks = read_tracks(document, Accessors(document), document.rows("animations")[number], place)
    nodes = read_nodes(document)
    animated = {node for node, what in tracks if what != "scale"}
    joints = choose_joints(document, nodes, animated, root)
    used = [track for (node, what), track in tracks.items() if node in set(joints.nodes) and what != "scale"]
    rate = _checked_rate(document, fps) or (key_rate(used) if used else 60.0)
    times = _frame_times(document, place, used, rate, len(joints.nodes))
    notes = list(joints.notes)
    placed = _joint_tracks(nodes, joints, tracks, times, rate, METRES_PER_UNIT[unit], notes)
    motion, more, folded = root_motion(placed, str(path), root=root, stretch_m=stretch_m, above=joints.above)
    return MotionFile(motion, Report("gltf", (*notes, *more), folded, clips, number))


def clip_names(path: str | Path) -> tuple[str, ...]:
    """Names of the animations of a file; one without a name is called by its index.

    Raises
    ------
    MotionFileError
        The file is invalid.
    """
    return _clip_names(open_document(Path(path)))


def _clip_names(document: Document) -> tuple[str, ...]:
    rows = document.rows("animations")
    return tuple(document.text(row, "name", f"animations[{k}]") or f"animation {k}" for k, row in enumerate(rows))


def _choose_clip(document: Document, clip: str | int | None) -> tuple[int, tuple[str, ...]]:
    """Index of the animation to read, and the names of all."""
    clips = _clip_names(document)
    listed = ", ".join(f"'{name}'" for name in clips[:8]) + ", …" * (len(clips) > 8)
    if not clips:
        document.fail("animations", "an animation", "none", "export the file with its animation")
    if clip is None and len(clips) > 1:
        document.fail("animations", "one animation, or the choice of one", listed, "name it as clip")
    if isinstance(clip, str) and clip not in clips:
        document.fail("animations", f"an animation '{clip[:60]}'", listed, "name one of these as clip")
    index = clips.index(clip) if isinstance(clip, str) else clip or 0
    if not 0 <= index < len(clips):
        document.fail("animations", f"the index of one of {len(clips)} animations", str(clip), "name it as clip")
    return index, clips


def _checked_rate(document: Document, fps: float | None) -> float | None:
    if fps is not None and not 0.0 < fps <= MAX_FPS:
        raise MotionFileError(document.path, None, f"a rate above 0 and up to {MAX_FPS:g} fps", f"{fps}")
    return fps


def _frame_times(document: Document, place: str, tracks: list[Track], fps: float, joints: int) -> F64:
    """Seconds (F,) of the frames: from the first key to the last."""
    start = min((float(track.times[0]) for track in tracks), default=0.0)
    end = max((float(track.times[-1]) for track in tracks), default=0.0)
    frames = int(np.floor((end - start) * fps + 0.02)) + 1
    if frames > MAX_FRAMES or frames * joints > _MAX_ROTATIONS:
        found = f"{frames} frames × {joints} joints at {fps:.6g} fps"
        document.fail(place, f"at most {MAX_FRAMES} frames and {_MAX_ROTATIONS} frames × joints", found, "cut the clip")
    return start + np.arange(frames) / fps


def _joint_tracks(
    nodes: list[Node], joints: Joints, tracks: Tracks, times: F64, fps: float, metres: float, notes: list[Note]
) -> JointTracks:
    """Local transforms of all joints at the frames, in metres; those of the fixed nodes above go into the first."""
    order = joints.nodes
    index = {node: k for k, node in enumerate(order)}
    parents = np.array([index.get(nodes[node].parent, -1) for node in order], np.int64)
    parents[0] = -1
    scales = {node: _scale(nodes[node], tracks.get((node, "scale")), times, notes) for node in (*joints.fixed, *order)}
    world, turn, scale = fixed_transform(nodes, joints.fixed, scales, notes)
    factors = np.empty((len(order), 3))
    offsets, rotations = np.empty((len(order), 3)), np.empty((len(times), len(order), 4))
    positions: dict[int, F64] = {}
    for k, node in enumerate(order):
        above = parents[k]
        inherited = scale if above < 0 else inherited_scale(factors[above], scales[order[above]])
        factors[k] = inherited
        offsets[k] = metres * inherited * nodes[node].translation
        rotation, translation = tracks.get((node, "rotation")), tracks.get((node, "translation"))
        rotations[:, k] = nodes[node].rotation if rotation is None else sample(rotation, times)
        if translation is not None:
            positions[k] = metres * inherited * sample(translation, times)
    place = positions.get(0, np.tile(offsets[0], (len(times), 1)))
    positions[0] = metres * world + quat.rotate(turn, place)
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    tips = [nodes[tip] for tip in joints.tips]
    carriers = [index[tip.parent] for tip in tips]
    reach = [metres * inherited_scale(factors[k], scales[order[k]]) for k in carriers]
    return JointTracks(
        names=unique_names([nodes[node].name for node in order]),
        parents=parents,
        offsets=offsets,
        rotations=rotations,
        positions=positions,
        tip_parents=np.array(carriers, np.int64),
        tip_offsets=np.array([size * tip.translation for size, tip in zip(reach, tips, strict=True)]).reshape(-1, 3),
        fps=fps,
        places=[f"nodes[{node}]" for node in order],
    )


def _scale(node: Node, track: Track | None, times: F64, notes: list[Note]) -> F64:
    """Constant scale (3,) of a joint; a scale that changes is reported and ignored."""
    scale = node.scale
    if track is not None:
        found = sample(track, times)
        low, high = found.min(axis=0), found.max(axis=0)
        if (high - low <= SCALED * np.abs(high)).all() and (low > 1e-9).all():
            scale = found.mean(axis=0)
        else:
            text = f"the scale of joint '{node.name}' changes from {low.min():.3g} to {high.max():.3g}; it is ignored"
            notes.append(Note("scale", node.name, text))
    return node_scale(node, scale, notes)


def unique_names(names: list[str]) -> tuple[str, ...]:
    """Names in their order; one that stands again gets the next free number."""
    taken = set(names)
    seen: set[str] = set()
    result = []
    for name in names:
        unique, number = name, 1
        while unique in seen or (unique != name and unique in taken):
            number += 1
            unique = f"{name}.{number}"
        seen.add(unique)
        result.append(unique)
    return tuple(result)
