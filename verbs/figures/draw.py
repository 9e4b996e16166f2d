"""Pictures of poses: cells with one body each, in rows or a grid, or all bodies laid over each other.

Nothing here is needed to pose a verb; matplotlib comes with ``adverb[figures]`` and is imported on use.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from verbs.conventions import F64, Floats
from verbs.errors import UnknownName
from verbs.figures import canvas
from verbs.figures.bodies import limbs_of, pieces, points
from verbs.figures.sheet import PALETTE, Cell, Sheet, arrange
from verbs.skeleton import Skeleton

__all__ = ["PALETTE", "VIEWS", "Cell", "draw_cells", "draw_poses", "points", "screen_axes"]

VIEWS = {"front": (0.0, 0.0), "side": (-90.0, 0.0), "three_quarter": (-38.0, 9.0), "left": (90.0, 0.0)}
"""Camera azimuth (0 looks the character in the face, -90 stands at its right hand) and elevation, degrees."""

View = str | tuple[float, float]


def draw_poses(
    skeleton: Skeleton,
    poses: Sequence[Floats],
    path: str | Path,
    *,
    view: View = "three_quarter",
    layout: str = "row",
    columns: int = 8,
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
    labels : sequence of str
        A line of text under each pose.
    marks : sequence of (3,) or None
        A target to show with each pose.
    trace : (N, 3), optional
        A path to draw with the last pose, such as an effector's way.
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
    count, onion = len(poses), layout == "onion"
    cells = [
        Cell(
            pose,
            labels[k] if k < len(labels) else "",
            marks[k] if k < len(marks) else None,
            trace if k == count - 1 else None,
            True,
            0.78 * (1 - (k + 1) / count) if onion else 0.0,
        )
        for k, pose in enumerate(poses)
    ]
    draw_cells(skeleton, cells, path, view=view, columns=0 if onion else columns, ground=ground, scale=pixels_per_m)


def draw_cells(
    skeleton: Skeleton,
    cells: Sequence[Cell],
    path: str | Path,
    *,
    view: View,
    columns: int,
    heads: Sequence[str] = (),
    sides: Sequence[str] = (),
    ground: bool = True,
    scale: float = 0.0,
    width_px: float = 1280.0,
) -> None:
    """Draw cells in rows of ``columns``; all in one place where ``columns`` is 0.

    Parameters
    ----------
    skeleton : Skeleton
    cells : sequence of Cell
    path : str or Path
    view : str or (azimuth, elevation)
    columns : int
    heads, sides : sequence of str
        Text over the columns and left of the rows of a grid.
    ground : bool
        Whether to draw shadows on the ground, at y = 0; a mount at the root instead where not.
    scale : float
        Pixels per metre; 0 chooses it so that the picture is about ``width_px`` wide.
    width_px : float

    Raises
    ------
    UnknownName
        If a view does not exist.
    VerbError
        If matplotlib is missing.
    """
    canvas.require()
    frame = screen_axes(view)
    layout = arrange(cells, frame, columns, heads, sides, scale=scale, width_px=width_px, ground=ground)
    sheet = Sheet(cells, frame, layout, heads, sides)
    limbs = limbs_of(skeleton)
    for index, cell in enumerate(cells):
        if ground and (columns or index == len(cells) - 1):
            sheet.ground(index)
        elif not ground:
            sheet.mount(index)
        if not cell.over:
            sheet.path(index)
        for piece in pieces(skeleton, limbs, sheet.screens[index]):
            far = np.clip(0.30 * (sheet.depths[index] - piece.depth), 0.0, 0.22)
            sheet.fill(piece.outline + layout.origins[index], piece.side, 1 - (1 - cell.faint) * (1 - far), piece.edge)
        if cell.over:
            sheet.path(index)
    sheet.save(Path(path))


def screen_axes(view: View) -> F64:
    """Axes (3, 3) of the screen, one to a row: right, up, toward the viewer."""
    if isinstance(view, str):
        if view not in VIEWS:
            raise UnknownName("view", view, VIEWS)
        view = VIEWS[view]
    azimuth, elevation = np.radians(view)
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    toward = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    return np.stack([right, np.cross(toward, right), toward])
