"""Strips of a verb: poses through time, poses over one adverb, and a grid of poses over two.

Source: Rose, Sloan, Cohen 2001, figures 15 to 18.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64
from verbs.domain import inside
from verbs.figures.draw import VIEWS, Cell, points, screen_axes
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.runtime.evaluate import Evaluator, Poses
from verbs.verb import Verb

__all__ = ["ACROSS", "DOWN", "Strip", "chart_labels", "examples_at", "stands", "strips", "view_of"]

ACROSS, DOWN = 9, 5
"""Cells of a strip, and rows of a grid; a grid has two columns fewer."""

_PATH_S = 0.25
_FAINT = 0.62
_SHORT = 4
_NEAR = 0.25
"""An example belongs to a strip if its other adverbs differ by this share of their ranges at most."""

_STANDS_M = (-0.2, 0.5)
_PLANAR_M = 1e-3


_BENT = {
    (charts.CYLINDER, 0): ("angle", "°"),
    (charts.CYLINDER, 2): ("distance", " m"),
    (charts.PLANAR, 0): ("left", " m"),
    (charts.PLANAR, 1): ("forward", " m"),
}
"""Names and units of the axes of bent charts."""


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Cells of one picture, and what the page states about it.

    Parameters
    ----------
    name : str
        Part of the file name: ``time``, ``grid``, or an adverb.
    title, caption : str
    cells : list of Cell
        In rows, the highest row of a grid first.
    columns : int
    heads, sides : list of str
        Text over columns and beside rows.
    error : float
        Largest error of the cells inside the domain, in the measure's unit; NaN where nothing is measured.
    clamped : int
        Cells whose adverbs were moved back to the domain.
    """

    name: str
    title: str
    caption: str
    cells: list[Cell]
    columns: int
    heads: list[str]
    sides: list[str]
    error: float
    clamped: int


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """Poses of some adverbs at one phase, moved so that travelling figures stay in their cells."""

    adverbs: F64
    bodies: F64
    marks: F64 | None
    paths: F64 | None
    clamped: npt.NDArray[np.bool_]
    error: F64


def strips(verb: Verb) -> list[Strip]:
    """All strips of a verb: through time, along each adverb, and over the two adverbs that change the pose most."""
    evaluator = Evaluator(verb)
    middle, phase = _middle(verb), _phase(verb)
    lines = [_row(evaluator, _line(verb, middle, axis), phase) for axis in range(len(verb.adverbs))]
    found = [_through_time(evaluator, middle)]
    found += [_along(verb, row, axis) for axis, row in enumerate(lines)]
    if len(lines) > 1:
        first, second = sorted(np.argsort([-_change(row) for row in lines], kind="stable")[:2].tolist())
        bent = verb.domain.chart.kind == charts.CYLINDER
        found.append(_around(evaluator, phase) if bent else _grid(evaluator, middle, phase, (first, second)))
    return found


def view_of(verb: Verb) -> tuple[float, float]:
    """Azimuth and elevation, degrees: in front of a planar skeleton, beside a figure that travels or kicks.

    Other figures are seen from the front, turned toward the side of their effector.
    """
    found = Evaluator(verb).pose(verb.values, phase=0.5)
    if float(np.ptp(points(verb.skeleton, found.root, found.rotations)[..., 2])) < _PLANAR_M:
        return VIEWS["front"]
    name = verb.skeleton.names[verb.measure.effector]
    side = 1.0 if name.startswith("Left") else -1.0
    if verb.measure.kind in (measures.JUMP, measures.VELOCITY) or verb.root_motion == poses.STRIDE:
        return side * 62.0, 12.0
    if verb.measure.kind == measures.POSITION and "Foot" in name:
        return side * 55.0, 10.0
    return side * (24.0 if len(verb.measure.axes) == 2 else 38.0), 9.0


def stands(bodies: F64) -> bool:
    """Whether a figure with joints at (..., 3) stands on the ground."""
    return _STANDS_M[0] < float(bodies[..., 1].min()) < _STANDS_M[1]


def examples_at(
    values: F64, cells: F64, axes: tuple[int, ...], clamped: npt.NDArray[np.bool_] | None = None
) -> list[int]:
    """Cells nearest to an example, of a strip or grid that runs along some axes.

    An example belongs to the strip if each of its other coordinates is within a quarter of the range. Clamped cells
    show other adverbs than their own, and are left out.

    Parameters
    ----------
    values : (N, D) float64
        Coordinates of the examples: adverbs, or points of a chart.
    cells : (B, D) float64
        Coordinates of the cells.
    axes : tuple of int
    clamped : (B,) bool, optional
    """
    ranges = np.maximum(np.ptp(values, axis=0), 1e-12)
    along = list(axes)
    others = [axis for axis in range(len(ranges)) if axis not in axes]
    found: set[int] = set()
    for example in values / ranges:
        gaps = cells[:, along] / ranges[along] - example[along]
        nearest = int(np.argmin(np.sum(gaps**2, axis=1)))
        if np.all(np.abs(example[others] - cells[nearest, others] / ranges[others]) <= _NEAR):
            found.add(nearest)
    return sorted(cell for cell in found if clamped is None or not clamped[cell])


def _middle(verb: Verb) -> F64:
    """Adverbs (D,) of the domain's middle."""
    return verb.domain.chart.adverbs(verb.domain.middle)


def _phase(verb: Verb) -> float:
    """Phase of the measure's keytime; else the start of a cycle, or the middle keytime."""
    if verb.measure.keytime >= 0:
        return float(verb.phases[verb.measure.keytime])
    return 0.0 if verb.looping else float(verb.phases[len(verb.phases) // 2])


def _line(verb: Verb, middle: F64, axis: int) -> F64:
    adverb = verb.adverbs[axis]
    rows = np.tile(middle, (ACROSS, 1))
    rows[:, axis] = np.linspace(adverb.minimum, adverb.maximum, ACROSS)
    return rows


def _row(evaluator: Evaluator, adverbs: F64, phase: float) -> _Row:
    verb = evaluator.verb
    found = evaluator.pose(adverbs, phase=phase)
    bodies = points(verb.skeleton, found.root, found.rotations)
    marks = evaluator.goal.points(adverbs) if verb.measure.kind == measures.POSITION else None
    paths = _paths(evaluator, found) if verb.looping else None
    shift = _shift(verb, found.root)
    return _Row(
        adverbs,
        bodies - shift[:, None],
        None if marks is None else marks - shift,
        None if paths is None else paths - shift[:, None],
        found.blend.clamped,
        found.blend.error,
    )


def _shift(verb: Verb, root: F64) -> F64:
    """What (B, 3) brings the bodies of a travelling verb to the middle of their cells; zero for others."""
    travels = verb.looping or verb.measure.kind == measures.JUMP or float(np.ptp(root[:, [0, 2]], axis=0).max()) > 0.6
    return root * (float(travels) * np.array([1.0, 0.0, 1.0]))


def _paths(evaluator: Evaluator, found: Poses) -> F64:
    """Way of the root over the ground in the next quarter of a second, (B, n, 3)."""
    paths = []
    for k in range(len(found.root)):
        times = found.time_s[k] + np.linspace(0.0, _PATH_S, 13)
        blend = evaluator.measure(
            found.blend.method, found.blend.weights[k : k + 1], np.zeros((1, 0)), np.zeros(1, bool)
        )
        paths.append(evaluator.pose_of(blend, time_s=times).root * np.array([1.0, 0.0, 1.0]))
    return np.array(paths)


def _change(row: _Row) -> float:
    """Mean distance over which joints and paths move along a strip, m."""
    kept = ~row.clamped if (~row.clamped).sum() > 1 else np.ones(len(row.clamped), bool)
    moved = float(np.linalg.norm(np.ptp(row.bodies[kept], axis=0), axis=-1).mean())
    return moved + (
        float(np.linalg.norm(np.ptp(row.paths[kept], axis=0), axis=-1).mean()) if row.paths is not None else 0.0
    )


def _through_time(evaluator: Evaluator, middle: F64) -> Strip:
    """Poses at even phases; keytimes take the place of the phases nearest to them."""
    verb = evaluator.verb
    phases = np.arange(ACROSS) / ACROSS if verb.looping else np.linspace(0.0, 1.0, ACROSS)
    names = [""] * ACROSS
    for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True):
        nearest = int(np.argmin(np.abs(phases - phase)))
        if not names[nearest] and abs(phases[nearest] - phase) < 1.0 / ACROSS:
            phases[nearest], names[nearest] = phase, name
    found = evaluator.pose_of(evaluator.blend(middle[None]), phase=phases)
    bodies, shift = points(verb.skeleton, found.root, found.rotations), _shift(verb, found.root)
    paths = _trails(evaluator, found, phases)
    labels = [f"{time:.2f} s" + (f"\n{name}" if name else "") for time, name in zip(found.time_s, names, strict=True)]
    cells = [Cell(body - move, label, path=path - move, over=not verb.looping, boxed=bool(name))
             for body, move, label, path, name in zip(bodies, shift, labels, paths, names, strict=True)]  # fmt: skip
    line = "the path of the root over the ground" if verb.looping else f"the path of {_joint(verb)} so far"
    where = ", ".join(_value(verb, axis, middle[axis]) for axis in range(len(middle)))
    caption = f"Poses at even phases; keytimes are framed. The line is {line}. {where}."
    return Strip("time", "Through time, in the middle of the domain", caption, cells, ACROSS, [], [],
                 _largest(found.blend.error, found.blend.clamped), 0)  # fmt: skip


def _trails(evaluator: Evaluator, found: Poses, phases: F64) -> list[F64]:
    """Path of the effector until each phase; of the root over the ground for a looping verb."""
    verb = evaluator.verb
    fine = np.linspace(0.0, 1.0, 121)
    dense = evaluator.pose_of(found.blend, phase=fine)
    if verb.looping:
        way = dense.root * np.array([1.0, 0.0, 1.0])
        return [way[np.abs(fine - phase) <= 0.2] for phase in phases]
    way = points(verb.skeleton, dense.root, dense.rotations)[:, verb.measure.effector]
    return [way[fine <= phase + 1e-9] for phase in phases]


def _along(verb: Verb, row: _Row, axis: int) -> Strip:
    boxed = examples_at(verb.values, row.adverbs, (axis,), row.clamped)
    labels = [_value(verb, axis, value, bare=True) for value in row.adverbs[:, axis]]
    cells = _cells(row, labels, boxed)
    others = [_value(verb, k, row.adverbs[0, k]) for k in range(len(verb.adverbs)) if k != axis]
    caption = _notes(row, boxed, marks=row.marks is not None, paths=row.paths is not None)
    title = f"Along {verb.adverbs[axis].name}" + (f", with {', '.join(others)}" if others else "")
    error = _largest(row.error, row.clamped)
    name = verb.adverbs[axis].name
    name = f"along_{name}" if name in ("time", "grid") else name
    return Strip(name, title, caption, cells, ACROSS, [], [], error, int(row.clamped.sum()))


def _grid(evaluator: Evaluator, middle: F64, phase: float, axes: tuple[int, int]) -> Strip:
    """Grid over two adverbs, laid out as their goals lie on the screen where they are positions."""
    verb = evaluator.verb
    (across, right), (down, up) = _layout(verb, axes)
    one, two = verb.adverbs[across], verb.adverbs[down]
    columns = np.linspace(one.minimum, one.maximum, ACROSS - 2)[:: 1 if right else -1]
    rows = np.linspace(two.minimum, two.maximum, DOWN)[:: -1 if up else 1]
    adverbs = _spread(middle, (across, columns), (down, rows))
    row = _row(evaluator, adverbs, phase)
    boxed = examples_at(verb.values, adverbs, (across, down), row.clamped)
    others = [_value(verb, k, middle[k]) for k in range(len(middle)) if k not in axes]
    title = f"{one.name} (across) and {two.name} (up)" + (f", with {', '.join(others)}" if others else "")
    heads, sides = (
        [_named(verb, axis, value) for value in values] for axis, values in ((across, columns), (down, rows))
    )
    return _grid_of(row, boxed, title, heads, sides)


def _around(evaluator: Evaluator, phase: float) -> Strip:
    """Grid over angle and height about the axis of a cylinder, where most of a grid of x and z is outside the hull."""
    verb, chart = evaluator.verb, evaluator.verb.domain.chart
    values = chart.points(verb.values)
    low, high = values.min(axis=0), values.max(axis=0)
    across, down = int(chart.axes[0]), int(chart.axes[1])
    columns = np.linspace(low[across], high[across], ACROSS - 2)
    rows = np.linspace(high[down], low[down], DOWN)
    places = _spread(verb.domain.middle, (across, columns), (down, rows))
    off = int(chart.axes[2])
    places[:, off] = _between(verb, places, off, np.linspace(low[off], high[off], 61))
    row = _row(evaluator, chart.adverbs(places), phase)
    boxed = examples_at(values, places, (across, down), row.clamped)
    labels = [chart_labels(verb, axis, row.adverbs) for axis in (across, down)]
    title = "angle (across) and height (up) about the middle of the examples, the distance in the middle of the domain"
    count = len(columns)
    return _grid_of(row, boxed, title, labels[0][:count], labels[1][::count])


def _between(verb: Verb, places: F64, axis: int, values: F64) -> F64:
    """Middle (B,) of the values on a chart axis that lie in the hull at places (B, D); unchanged where none does."""
    tried = np.repeat(places[:, None], len(values), axis=1)
    tried[..., axis] = values
    fits = inside(verb.domain, tried)
    mean = (fits * values).sum(axis=1) / np.maximum(fits.sum(axis=1), 1)
    return np.asarray(np.where(fits.any(axis=1), mean, places[:, axis]))


def _spread(middle: F64, across: tuple[int, F64], down: tuple[int, F64]) -> F64:
    """Coordinates (rows · columns, D) of a grid over two axes."""
    places = np.tile(middle, (len(down[1]), len(across[1]), 1))
    places[..., across[0]], places[..., down[0]] = across[1], down[1][:, None]
    return places.reshape(-1, len(middle))


def _grid_of(row: _Row, boxed: list[int], title: str, heads: list[str], sides: list[str]) -> Strip:
    cells = _cells(row, [""] * len(row.adverbs), boxed)
    caption = _notes(row, boxed, marks=row.marks is not None, paths=row.paths is not None)
    error = _largest(row.error, row.clamped)
    return Strip("grid", f"Over {title}", caption, cells, len(heads), heads, sides, error, int(row.clamped.sum()))


def _layout(verb: Verb, axes: tuple[int, int]) -> tuple[tuple[int, bool], tuple[int, bool]]:
    """Adverb across and whether it rises to the right; adverb up and whether it rises upward."""
    if verb.measure.kind != measures.POSITION or not set(axes) <= set(verb.measure.axes.tolist()):
        return (axes[0], True), (axes[1], True)
    frame = screen_axes(view_of(verb)) @ verb.measure.frame
    moves = [frame[:2, verb.measure.axes.tolist().index(axis)] for axis in axes]  # right, up
    steep = [abs(move[1]) - abs(move[0]) for move in moves]
    down = int(steep[1] >= steep[0])
    return (axes[1 - down], bool(moves[1 - down][0] >= 0)), (axes[down], bool(moves[down][1] >= 0))


def _cells(row: _Row, labels: list[str], boxed: list[int]) -> list[Cell]:
    return [
        Cell(
            row.bodies[k],
            labels[k],
            None if row.marks is None else row.marks[k],
            None if row.paths is None else row.paths[k],
            False,
            _FAINT if row.clamped[k] else 0.0,
            k in boxed,
        )
        for k in range(len(row.adverbs))
    ]


def _notes(row: _Row, boxed: list[int], *, marks: bool, paths: bool) -> str:
    """Sentences of a caption: what boxes, dots, lines and pale figures are."""
    notes = ["Frames mark the cells nearest to examples."] * bool(boxed)
    notes += ["Dots are goals."] * marks
    notes += [f"Lines are the path of the next {_PATH_S:g} s."] * paths
    notes += ["Pale: the goal is outside the domain and was clamped."] * bool(row.clamped.any())
    return " ".join(notes)


def _largest(error: F64, clamped: npt.NDArray[np.bool_]) -> float:
    kept = error[~clamped]
    return float(kept.max()) if len(kept) else float("nan")


def _joint(verb: Verb) -> str:
    return verb.skeleton.names[verb.measure.effector]


def _named(verb: Verb, axis: int, value: float) -> str:
    """Text beside a grid: name and value, in two lines where the name is long."""
    name = verb.adverbs[axis].name
    return f"{name}{' ' if len(name) < _SHORT else chr(10)}{_value(verb, axis, value, bare=True)}"


def _value(verb: Verb, axis: int, value: float, *, bare: bool = False) -> str:
    """Text such as ``height 0.42 m``, with as many digits as the range needs; without the name where ``bare``."""
    adverb = verb.adverbs[axis]
    unit, number = {"none": "", "deg": "°", "deg/s": "°/s"}.get(adverb.unit, adverb.unit), float(value)
    width = adverb.maximum - adverb.minimum
    if unit in ("rad", "rad/s"):
        unit, number, width = unit.replace("rad", "°"), float(np.degrees(number)), float(np.degrees(width))
    digits = int(np.clip(2 - np.floor(np.log10(max(width, 1e-9))), 0, 3)) if width < 20 else 0
    digits = min(digits, 2)
    text = f"{round(number, digits) + 0.0:.{digits}f}".replace("-", "−")
    tail = f"{text}{unit}" if unit.startswith("°") else f"{text} {unit}".rstrip()
    return tail if bare else f"{adverb.name} {tail}"


def chart_labels(verb: Verb, axis: int, rows: F64) -> list[str]:
    """Text such as ``angle 30°`` for each of some adverbs (B, D): their coordinate on a chart axis."""
    chart, adverb = verb.domain.chart, verb.adverbs[axis]
    coordinates = (verb.domain.chart.points(rows) / chart.scale + chart.shift)[:, axis]
    bent = (chart.kind, int(np.flatnonzero(chart.axes == axis)[0])) if axis in chart.axes else (charts.IDENTITY, 0)
    name, unit = _BENT.get(bent, (adverb.name.split("_")[0], " " + adverb.unit))
    if unit == "°":
        coordinates = np.degrees((coordinates / chart.bend[3] + chart.bend[2] + np.pi) % (2 * np.pi) - np.pi)
    digits = 0 if unit == "°" else 2
    return [
        f"{name} {coordinate + 0.0:.{digits}f}{unit}".replace("-", "−") for coordinate in np.round(coordinates, digits)
    ]
