"""Picture of cells: where they lie, their polygons from back to front, shadows, frames, paths and text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64, Floats
from verbs.figures import canvas

__all__ = ["PALETTE", "Cell", "Layout", "Sheet", "arrange"]

PALETTE = {
    "left": "#4f86a8",
    "right": "#e08a63",
    "centre": "#767d8c",
    "hips": "#5b6270",
    "ground": "#c9c4b8",
    "shadow": "#ece8de",
    "contact": "#cfc9bb",
    "paper": "#fbf9f4",
    "box": "#a8801c",
    "boxed": "#fdf8e6",
    "mark": "#c2410c",
    "ink": "#3f444d",
}

_GAP_M = 0.16
_STANDING_M = 0.14
_SHADOW_M = 0.40
_CHARACTER_PX, _LINE_PX, _MARGIN_PX = 7.0, 22.0, 12.0
"""Width of a character and height of a line of 9 pt text at 100 dpi; margin of a picture."""


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """One pose of a picture.

    Parameters
    ----------
    points : (J, 3) or (J + T, 3)
        Joint positions, as :func:`verbs.figures.bodies.points` gives them; with tips where they are there.
    label : str
        Text under the pose, in one line or two.
    mark : (3,), optional
        A target, drawn as a dot.
    path : (N, 3), optional
        A path that ends in an arrow, such as the root's way over the ground.
    over : bool
        Whether the path is drawn over the body.
    faint : float
        0 draws in full colours, 1 draws nothing.
    boxed : bool
    """

    points: Floats
    label: str = ""
    mark: Floats | None = None
    path: Floats | None = None
    over: bool = False
    faint: float = 0.0
    boxed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Places of cells on a picture, m.

    Parameters
    ----------
    scale : float
        Pixels per metre.
    across : int
        Cells of a row.
    origins : (P, 2) float64
        Where the origin of each pose lies.
    lows, sizes : (P, 2) float64
        Lower left corner of each cell, from its origin; and its width and height.
    first, last : (2,) float64
        Lower left and upper right corner of the picture.
    label_m : float
        Height of the text under poses.
    """

    scale: float
    across: int
    origins: F64
    lows: F64
    sizes: F64
    first: F64
    last: F64
    label_m: float


def arrange(
    cells: Sequence[Cell],
    frame: F64,
    columns: int,
    heads: Sequence[str],
    sides: Sequence[str],
    *,
    scale: float,
    width_px: float,
    ground: bool,
) -> Layout:
    """Layout in rows of ``columns``, as wide as the widest pose and each as high as its own; in one place for 0."""
    across = max(1, min(columns, len(cells)))
    order = np.arange(len(cells))
    row_of = order // across if columns else 0 * order
    low, high = (np.array(ends) for ends in zip(*(_extent(cell, frame, ground=ground) for cell in cells), strict=True))
    wide = float(high[:, 0].max() - low[:, 0].min()) + _GAP_M
    side_px = (_CHARACTER_PX * _longest(sides) + _MARGIN_PX) if sides else 0.0
    fitting = (width_px - side_px - 2 * _MARGIN_PX) / (across * wide)
    scale = scale or float(np.clip(fitting, 30.0, 260.0))
    wide = max(wide, (_CHARACTER_PX * _longest([*(cell.label for cell in cells), *heads]) + 8) / scale)
    label_m = max(_label_px(cell.label) for cell in cells) / scale
    left = 0.5 * float(high[:, 0].max() + low[:, 0].min()) - 0.5 * wide
    rows = range(int(row_of.max()) + 1)
    bottoms = np.array([low[row_of == row, 1].min() for row in rows]) - 0.5 * _GAP_M - label_m
    heights = np.array([high[row_of == row, 1].max() for row in rows]) + 0.5 * _GAP_M - bottoms
    origins = np.stack([(order % across) * wide * (columns > 0), -(np.cumsum(heights) + bottoms)[row_of]], axis=-1)
    lows = np.stack([np.full(len(cells), left), bottoms[row_of]], axis=-1)
    sizes = np.stack([np.full(len(cells), wide), heights[row_of]], axis=-1)
    margin, heads_px = _MARGIN_PX / scale, max(map(_label_px, heads), default=0.0)
    first = np.array([left - margin - side_px / scale, -float(heights.sum()) - margin])
    last = np.array([left + across * wide + margin, margin + heads_px / scale])
    return Layout(scale, across, origins, lows, sizes, first, last, label_m)


class Sheet:
    """Picture in the making: places of the cells, polygons from back to front, and text."""

    def __init__(
        self, cells: Sequence[Cell], frame: F64, layout: Layout, heads: Sequence[str], sides: Sequence[str]
    ) -> None:
        self.cells, self.frame, self.layout, self.heads, self.sides = cells, frame, layout, heads, sides
        self.world = [np.asarray(cell.points, np.float64) for cell in cells]
        self.screens = [pose @ frame.T for pose in self.world]
        self.depths = [float(screen[:, 2].mean()) for screen in self.screens]
        self.polygons: list[F64] = []
        self.colours: list[tuple[float, ...]] = []
        self.edges: list[tuple[float, ...]] = []

    def fill(self, outline: F64, colour: str, faint: float = 0.0, edge: bool = False) -> None:
        """Add a polygon (N, 2), m."""
        self.polygons.append(outline)
        self.colours.append(_pale(PALETTE[colour], faint))
        self.edges.append((*_pale(PALETTE["paper"], 0.0), 1.0) if edge else (0.0, 0.0, 0.0, 0.0))

    def ground(self, index: int) -> None:
        """Add a soft shadow under a pose, and darker ones where it touches the ground."""
        if self.cells[index].boxed:
            self._box(index)
        pose, angle = self.world[index], np.linspace(0.0, 2.0 * np.pi, 49)
        circle = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)
        middle = np.array([np.median(pose[:, 0]), 0.0, np.median(pose[:, 2])])
        self._on_ground(index, middle + _SHADOW_M * circle, "shadow")
        for place in pose[pose[:, 1] < _STANDING_M]:
            radius = 0.10 * (1.0 - max(0.0, float(place[1])) / _STANDING_M) + 0.01
            self._on_ground(index, place * np.array([1.0, 0.0, 1.0]) + radius * circle, "contact")

    def _on_ground(self, index: int, outline: F64, colour: str) -> None:
        flat = outline @ self.frame.T
        if np.ptp(flat[:, 1]) < 0.02:  # seen from the level of the ground: a line
            flat[:, 1] = np.where(np.arange(len(flat)) < len(flat) // 2, 0.0, -0.012)
        self.fill(flat[:, :2] + self.layout.origins[index], colour)

    def mount(self, index: int) -> None:
        """Add a disc behind the root of a skeleton that does not stand on the ground."""
        if self.cells[index].boxed:
            self._box(index)
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        disc = 0.07 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.fill(disc + self.screens[index][0, :2] + self.layout.origins[index], "ground")

    def _box(self, index: int) -> None:
        inset = 3.0 / self.layout.scale
        low = self.layout.lows[index] + self.layout.origins[index] + inset
        high = low + self.layout.sizes[index] - 2 * inset
        frame = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        self.fill(frame, "boxed")
        self.edges[-1] = (*_pale(PALETTE["box"], 0.0), 1.0)

    def path(self, index: int) -> None:
        """Add the path of a pose."""
        cell = self.cells[index]
        if cell.path is None:
            return
        way = (np.asarray(cell.path, np.float64) @ self.frame.T)[:, :2] + self.layout.origins[index]
        faint = 0.25 + 0.55 * cell.faint
        width, head = 1.1 / self.layout.scale, 5.0 / self.layout.scale
        along = np.diff(way, axis=0)
        kept = np.concatenate([[True], np.hypot(*along.T) > 1e-4])
        way = way[kept]
        if len(way) < 2:
            return
        along = np.gradient(way, axis=0)
        along /= np.hypot(*along.T)[:, None] + 1e-12
        across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        self.fill(np.concatenate([way + width * across, (way - width * across)[::-1]]), "mark", faint)
        tip, ahead, aside = way[-1], along[-1], across[-1]
        arrow = [tip + 1.6 * head * ahead, tip + head * aside, tip - head * aside]
        self.fill(np.array(arrow), "mark", faint)

    def save(self, path: Path) -> None:
        """Draw polygons, dots and text, and write the file."""
        from matplotlib.collections import PolyCollection

        at = self.layout
        figure = canvas.plain(*((at.last - at.first) * at.scale / 100), paper=PALETTE["paper"])
        axes: Any = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(at.first[0], at.last[0]), ylim=(at.first[1], at.last[1]))
        axes.axis("off")
        axes.add_collection(
            PolyCollection(self.polygons, facecolors=self.colours, edgecolors=self.edges, linewidths=0.8)
        )
        for k, (origin, cell) in enumerate(zip(at.origins, self.cells, strict=True)):
            if cell.mark is not None:
                x, y = (np.asarray(cell.mark) @ self.frame.T)[:2] + origin
                axes.plot(x, y, "o", ms=6, mec="white", mew=0.9, mfc=_pale(PALETTE["mark"], 0.6 * cell.faint))
            below = at.lows[k] + origin + np.array([0.5 * at.sizes[k][0], at.label_m])
            axes.text(*below, cell.label, ha="center", va="top", color=PALETTE["ink"], fontsize=9)
        self._titles(axes)
        figure.savefig(path, dpi=100, facecolor=PALETTE["paper"])
        figure.clear()
        if path.suffix == ".png":
            canvas.shrink(path)

    def _titles(self, axes: Any) -> None:
        at = self.layout
        for k, text in enumerate(self.heads):
            place = at.lows[k] + at.origins[k] + at.sizes[k] * (0.5, 1) + (0, 4.0 / at.scale)
            axes.text(*place, text, ha="center", va="bottom", color=PALETTE["ink"], fontsize=9)
        for row, text in enumerate(self.sides):
            k = row * at.across
            height = at.lows[k][1] + at.origins[k][1] + 0.5 * at.sizes[k][1]
            place = (at.first[0] + _MARGIN_PX / at.scale, height)
            axes.text(*place, text, ha="left", va="center", color=PALETTE["ink"], fontsize=9)


def _extent(cell: Cell, frame: F64, *, ground: bool) -> tuple[F64, F64]:
    """Lowest and highest corner (2,) that holds the body, mark, path and shadow of a cell."""
    drawn = [np.asarray(cell.points) @ frame[:2].T]
    if cell.mark is not None:
        drawn.append(np.asarray(cell.mark)[None] @ frame[:2].T)
    if cell.path is not None:
        drawn.append(np.asarray(cell.path) @ frame[:2].T)
    if ground:
        middle = np.median(np.asarray(cell.points), axis=0) * np.array([1.0, 0.0, 1.0]) @ frame[:2].T
        reach = _SHADOW_M * np.array([1.0, abs(frame[2, 1])])
        drawn.append(np.stack([middle - reach, middle + reach]))
    corners = np.concatenate(drawn)
    return corners.min(axis=0) - 0.05, corners.max(axis=0) + 0.05


def _longest(texts: Sequence[str]) -> int:
    """Characters of the longest line of some texts."""
    return max((len(line) for text in texts for line in text.split("\n")), default=0)


def _label_px(label: str) -> float:
    """Height of the text under a pose, pixels."""
    return _LINE_PX + 14.0 * label.count("\n") if label else 0.0


def _pale(colour: str, faint: float) -> tuple[float, ...]:
    """Mix a colour with the paper: solid colours stay clean where limbs overlap, transparent ones do not."""
    from matplotlib.colors import to_rgb

    mixed = (1 - faint) * np.array(to_rgb(colour)) + faint * np.array(to_rgb(PALETTE["paper"]))
    return tuple(float(channel) for channel in mixed)
