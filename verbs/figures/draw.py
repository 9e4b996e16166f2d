"""Pictures of poses: rounded limbs coloured by side, several poses in a row or laid over each other.

Nothing here is needed to pose a verb; matplotlib comes with ``adverb[figures]`` and is imported on use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64, Floats
from verbs.errors import UnknownName, VerbError
from verbs.kernels import fk, quat
from verbs.skeleton import Skeleton

__all__ = ["PALETTE", "VIEWS", "draw_poses", "points"]

VIEWS = {"front": (0.0, 0.0), "side": (-90.0, 0.0), "three_quarter": (-38.0, 9.0), "left": (90.0, 0.0)}
"""Camera azimuth (0 looks the character in the face, -90 stands at its right hand) and elevation, degrees."""

PALETTE = {
    "left": "#5b8fb0",
    "right": "#e08a63",
    "centre": "#6f7684",
    "ground": "#c9c4b8",
    "shadow": "#e9e5db",
    "paper": "#fbf9f4",
    "mark": "#c2410c",
    "ink": "#4a4f59",
}

# End of a joint's name: radius of the limb that leads to it, at its parent and at itself, metres.
_RADII = {
    "ToeBase": (0.042, 0.034),
    "Foot": (0.052, 0.036),
    "UpLeg": (0.080, 0.076),
    "Leg": (0.076, 0.052),
    "Hand": (0.041, 0.029),
    "ForeArm": (0.052, 0.042),
    "Arm": (0.058, 0.052),
    "Shoulder": (0.080, 0.060),
    "Neck": (0.085, 0.048),
    "Neck1": (0.048, 0.046),
    "Head": (0.046, 0.046),
    "Spine": (0.115, 0.118),
    "Spine1": (0.118, 0.115),
    "Spine2": (0.115, 0.115),
}
_TRUNK = ("Spine", "Spine1", "Spine2", "Neck", "Neck1", "Head", "Shoulder", "Arm", "UpLeg")  # drawn as one piece
_TRUNK_HULLS = (("LeftArm", "RightArm", "Spine1"), ("LeftUpLeg", "RightUpLeg", "Spine", "Spine1"))
_TIP_RADII = {"Hand": (0.032, 0.016), "ToeBase": (0.034, 0.024)}
_ARC = np.linspace(0.0, np.pi, 13)


@dataclass(frozen=True, slots=True)
class _Limb:
    """One rounded piece: two ends (index into points), two radii, and whose side it is on."""

    start: int
    end: int
    radii: tuple[float, float]
    side: str


def points(skeleton: Skeleton, root: Floats, rotations: Floats) -> F64:
    """Positions of all joints, then all tips, of poses.

    Parameters
    ----------
    skeleton : Skeleton
        The joints.
    root : (..., 3)
        Position of the root, metres.
    rotations : (..., J, 4)
        Local rotations.

    Returns
    -------
    points : (..., J + T, 3) float64
    """
    global_rotations, positions = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)
    tips = quat.rotate(global_rotations[..., skeleton.tip_parents, :], skeleton.tip_offsets)
    return np.concatenate([positions, positions[..., skeleton.tip_parents, :] + tips], axis=-2)


def draw_poses(
    skeleton: Skeleton,
    poses: Sequence[Floats],
    path: str | Path,
    *,
    view: str | tuple[float, float] = "three_quarter",
    layout: str = "row",
    columns: int = 8,
    spacing_m: float | None = None,
    labels: Sequence[str] = (),
    marks: Sequence[Floats | None] = (),
    trace: Floats | None = None,
    ground: bool = True,
    pixels_per_m: float = 180.0,
) -> None:
    """Draw poses into an image file.

    Parameters
    ----------
    skeleton : Skeleton
        The joints; names that begin with Left and Right choose the colours.
    poses : sequence of (J, 3) or (J + T, 3)
        Joint positions, as :func:`points` gives them; with tips where they are there.
    path : str or Path
        Image file; its ending chooses the format.
    view : str or (azimuth, elevation)
        A name in :data:`VIEWS`, or degrees.
    layout : {"row", "onion"}
        Side by side, ``columns`` to a row; or all in one origin, the earlier the paler.
    columns : int
        Poses per row.
    spacing_m : float, optional
        Distance between neighbours; as wide as the poses need unless given.
    labels : sequence of str
        A line of text under each pose.
    marks : sequence of (3,) or None
        A target to show with each pose.
    trace : (N, 3), optional
        A path to draw over onion layouts, such as an effector's way.
    ground : bool
        Whether to draw the ground, at y = 0.
    pixels_per_m : float
        Scale of the image.

    Raises
    ------
    UnknownName
        If a view or layout does not exist.
    VerbError
        If matplotlib is missing.
    """
    if layout not in ("row", "onion"):
        raise UnknownName("layout", layout, ("row", "onion"))
    screens = _project(poses, view)
    origins = _places(screens, columns if layout == "row" else 0, spacing_m)
    limbs = _limbs(skeleton)
    lowest = min(0.0, *(float(screen[:, 1].min()) for screen in screens))
    figure, axes = _canvas(screens, origins, pixels_per_m, labelled=bool(labels))
    for index, (screen, origin) in enumerate(zip(screens, origins, strict=True)):
        faint = 0.0 if layout == "row" else 0.78 * (1 - (index + 1) / len(screens))
        if ground and (layout == "row" or index == len(screens) - 1):
            _draw_ground(axes, screen, origin, view)
        _draw_figure(axes, skeleton, limbs, screen, origin, faint, 100 * (index + 1))
        below = origin + np.array([float(np.mean(_ground_ends(screen))), lowest - 0.10])
        _annotate(axes, origin, below, view, marks[index : index + 1], labels[index : index + 1])
    if trace is not None:
        way = _project([trace], view)[0]
        axes.plot(way[:, 0], way[:, 1], "-", color=PALETTE["mark"], lw=1.6, alpha=0.8, zorder=1e6)
    figure.savefig(path, dpi=100, facecolor=PALETTE["paper"])
    figure.clear()


def _annotate(
    axes: Any,
    origin: F64,
    below: F64,
    view: str | tuple[float, float],
    marks: Sequence[Floats | None],
    labels: Sequence[str],
) -> None:
    """Add the target and the line of text that belong to one pose, where there are any."""
    for mark in marks:
        if mark is not None:
            x, y, _ = _project([np.asarray(mark)[None]], view)[0][0]
            axes.plot(x + origin[0], y + origin[1], "o", ms=7, mec="white", mfc=PALETTE["mark"], zorder=1e6)
    for label in labels:
        axes.text(*below, label, ha="center", va="top", color=PALETTE["ink"], fontsize=9)


def _project(poses: Sequence[Floats], view: str | tuple[float, float]) -> list[F64]:
    """Screen coordinates (N, 3) of each pose: right, up, toward the viewer."""
    if isinstance(view, str):
        if view not in VIEWS:
            raise UnknownName("view", view, VIEWS)
        view = VIEWS[view]
    azimuth, elevation = np.radians(view)
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    toward = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    frame = np.stack([right, np.cross(toward, right), toward])
    return [np.asarray(pose, np.float64) @ frame.T for pose in poses]


def _places(screens: list[F64], columns: int, spacing_m: float | None) -> F64:
    """Where the origin of each pose lies on the picture, metres (P, 2); all at zero where ``columns`` is 0."""
    order = np.arange(len(screens))
    if columns == 0:
        return np.zeros((len(screens), 2))
    low = np.min([screen[:, :2].min(axis=0) for screen in screens], axis=0)
    high = np.max([screen[:, :2].max(axis=0) for screen in screens], axis=0)
    wide = spacing_m if spacing_m is not None else float(high[0] - low[0]) + 0.22
    tall = float(high[1] - low[1]) + 0.42
    return np.stack([(order % columns) * wide, -(order // columns) * tall], axis=-1)


def _canvas(screens: list[F64], origins: F64, pixels_per_m: float, *, labelled: bool) -> tuple[Any, Any]:
    """Give an empty figure and axes that hold every pose with a margin, at the wanted scale."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as err:
        raise VerbError("drawing needs matplotlib: pip install 'adverb[figures]'") from err
    corners = [
        np.concatenate([screen[:, :2], [[x, 0.0] for x in _ground_ends(screen)]]) + origin
        for screen, origin in zip(screens, origins, strict=True)
    ]
    low = np.min([corner.min(axis=0) for corner in corners], axis=0) - np.array([0.2, 0.30 if labelled else 0.16])
    high = np.max([corner.max(axis=0) for corner in corners], axis=0) + np.array([0.2, 0.16])
    figure = Figure(figsize=tuple((high - low) * pixels_per_m / 100))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.axis("off")
    return figure, axes


def _limbs(skeleton: Skeleton) -> list[_Limb]:
    limbs = []
    for joint in range(1, len(skeleton)):
        length = float(np.linalg.norm(skeleton.offsets[joint]))
        radii = _radii(_RADII, skeleton.names[joint], length)
        side = "trunk" if _ending(_RADII, skeleton.names[joint]) in _TRUNK else _side(skeleton.names[joint])
        limbs.append(_Limb(int(skeleton.parents[joint]), joint, radii, side))
    for tip, joint in enumerate(skeleton.tip_parents):
        name = skeleton.names[joint]
        length = float(np.linalg.norm(skeleton.tip_offsets[tip]))
        if name != "Head" and length > 0:
            radii = _radii(_TIP_RADII, name, length)
            limbs.append(_Limb(int(joint), len(skeleton) + tip, radii, _side(name)))
    return limbs


def _radii(table: dict[str, tuple[float, float]], name: str, length: float) -> tuple[float, float]:
    """Radii of a limb by its joint's name; by its length where the table does not know the name."""
    return table.get(_ending(table, name), (min(0.05, 0.11 * length), min(0.04, 0.08 * length)))


def _ending(table: dict[str, tuple[float, float]], name: str) -> str:
    """Longest ending of a joint's name that stands in a table, or nothing."""
    return max((ending for ending in table if name.endswith(ending)), key=len, default="")


def _side(name: str) -> str:
    return "left" if name.startswith("Left") else "right" if name.startswith("Right") else "centre"


def _draw_figure(
    axes: Any, skeleton: Skeleton, limbs: list[_Limb], screen: F64, origin: F64, faint: float, layer: float
) -> None:
    """Draw one pose, the pieces far from the viewer first."""
    shifted = screen + np.array([*origin, 0.0])
    drawn = [limb for limb in limbs if limb.end < len(screen)]
    for limb in drawn:
        if limb.side != "trunk":
            # Thighs go behind the trunk unless they are well before it, so that hips look the same in every pose.
            behind = 0.08 if skeleton.names[limb.start].endswith("UpLeg") else 0.0
            depth = 0.5 * (screen[limb.start, 2] + screen[limb.end, 2]) - behind
            outline = _capsule(shifted[limb.start, :2], shifted[limb.end, :2], *limb.radii)
            colour = _pale(PALETTE[limb.side], faint)
            axes.fill(*outline.T, fc=colour, ec=PALETTE["paper"], lw=0.8, zorder=layer + depth)
    trunk = [limb for limb in drawn if limb.side == "trunk"]
    trunk_depth = float(np.mean([screen[limb.end, 2] for limb in trunk])) if trunk else 0.0
    _draw_trunk(axes, skeleton, trunk, shifted, faint, layer + trunk_depth)
    for tip, joint in enumerate(skeleton.tip_parents):
        if skeleton.names[joint] == "Head" and len(skeleton) + tip < len(screen):
            top, base = shifted[len(skeleton) + tip], shifted[joint]
            outline = _capsule((0.75 * base + 0.25 * top)[:2], (0.42 * base + 0.58 * top)[:2], 0.085, 0.098)
            depth = max(screen[joint, 2], trunk_depth) + 0.02  # or the neck would show through the face
            axes.fill(
                *outline.T,
                fc=_pale(PALETTE["centre"], faint),
                ec=PALETTE["paper"],
                lw=0.8,
                zorder=layer + depth,
            )


def _draw_trunk(axes: Any, skeleton: Skeleton, limbs: list[_Limb], shifted: F64, faint: float, layer: float) -> None:
    """Draw the trunk: every outline first, then every filling, so that its pieces melt into one."""
    from scipy.spatial import ConvexHull

    outlines = [_capsule(shifted[limb.start, :2], shifted[limb.end, :2], *limb.radii) for limb in limbs]
    for names in _TRUNK_HULLS:
        if set(names) <= set(skeleton.names):
            discs = [
                _capsule(centre, centre, radius, radius)
                for name in names
                for centre, radius in ((shifted[skeleton.index(name), :2], _radii(_RADII, name, 0.1)[1]),)
            ]
            corners = np.concatenate(discs)
            outlines.append(corners[ConvexHull(corners).vertices])
    for outline in outlines:
        colour = _pale(PALETTE["centre"], faint)
        axes.fill(*outline.T, fc=colour, ec=PALETTE["paper"], lw=1.6, zorder=layer)
        axes.fill(*outline.T, fc=colour, lw=0, zorder=layer + 1e-3)


def _ground_ends(screen: F64) -> tuple[float, float]:
    """Left and right end of the piece of ground under a pose."""
    middle = float(np.median(screen[:, 0]))
    return middle - 0.42, middle + 0.42


def _draw_ground(axes: Any, screen: F64, origin: F64, view: str | tuple[float, float]) -> None:
    """Draw the ground under a pose: a line from level, a soft ellipse from above."""
    elevation = np.radians((VIEWS[view] if isinstance(view, str) else view)[1])
    low, high = np.add(_ground_ends(screen), origin[0])
    if elevation > 0:
        angle = np.linspace(0, 2 * np.pi, 61)
        half = 0.5 * (high - low)
        outline = [low + half * (1 + np.cos(angle)), origin[1] + half * np.sin(elevation) * np.sin(angle)]
        axes.fill(*outline, fc=PALETTE["shadow"], zorder=0)
    else:
        ends = [low, high]
        axes.plot(ends, [origin[1]] * 2, color=PALETTE["ground"], lw=2, solid_capstyle="round", zorder=0)


def _capsule(start: F64, end: F64, start_radius: float, end_radius: float) -> F64:
    """Outline (N, 2) of two discs and the straight sides that touch them both."""
    along = end - start
    length = float(np.hypot(*along))
    if length <= abs(start_radius - end_radius):  # one disc hides the other
        centre, radius = (start, start_radius) if start_radius >= end_radius else (end, end_radius)
        return np.asarray(centre + radius * np.stack([np.cos(2 * _ARC), np.sin(2 * _ARC)], axis=-1))
    heading = np.arctan2(along[1], along[0])
    lean = np.arcsin((start_radius - end_radius) / length)
    far = heading - np.pi / 2 + lean + (_ARC / np.pi) * (np.pi - 2 * lean)
    near = heading + np.pi / 2 - lean + (_ARC / np.pi) * (np.pi + 2 * lean)
    caps = [
        centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for centre, radius, angle in ((end, end_radius, far), (start, start_radius, near))
    ]
    return np.concatenate(caps)


def _pale(colour: str, faint: float) -> tuple[float, ...]:
    """Mix a colour with the paper: solid colours stay clean where limbs overlap, transparent ones do not."""
    from matplotlib.colors import to_rgb

    mixed = (1 - faint) * np.array(to_rgb(colour)) + faint * np.array(to_rgb(PALETTE["paper"]))
    return tuple(float(channel) for channel in mixed)
