"""Plots as SVG elements, in the colours of the page that holds them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["Line", "legend", "plot"]

WIDTH, HEIGHT = 560.0, 230.0
LEFT, RIGHT, TOP, BOTTOM = 54.0, 14.0, 12.0, 36.0


@dataclass(frozen=True, slots=True)
class Line:
    """A line: its label, the number of its colour (1 to 4), points, and whether it is dashed or filled."""

    label: str
    colour: int
    xs: Sequence[float]
    ys: Sequence[float]
    dashed: bool = False
    filled: bool = False


@dataclass(frozen=True, slots=True)
class _Axis:
    low: float
    high: float
    ticks: list[tuple[float, str]]
    map: Callable[[float], float]


def plot(
    lines: Sequence[Line], *, x_label: str, y_label: str, log: bool = False,
    x_ticks: Sequence[tuple[float, str]] | None = None,
) -> str:  # fmt: skip
    """A plot of lines; points that are not finite, or not positive on a logarithmic axis, are left out."""
    rows = [(line, _points(line, log=log)) for line in lines]
    points = [point for _, found in rows for point in found]
    if not points:
        return '<p class="none">no values</p>'
    xs, ys = [x for x, _ in points], [y for _, y in points]
    across = _linear(min(xs), max(xs)) if x_ticks is None else _fixed(x_ticks)
    up = _logarithmic(min(ys), max(ys)) if log else _linear(0.0, max(ys))
    parts = [
        f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{escape(y_label)} over {escape(x_label)}">'
    ]
    parts += _grid(across, up)
    for line, found in rows:
        parts += _line(line, [(_x(across, x), _y(up, y)) for x, y in found], found)
    middle = 0.5 * (LEFT + WIDTH - RIGHT)
    parts.append(f'<text x="{middle:g}" y="{HEIGHT - 4:g}" text-anchor="middle">{escape(x_label)}</text>')
    parts.append(f'<text x="12" y="{HEIGHT / 2:g}" text-anchor="middle" transform="rotate(-90 12 {HEIGHT / 2:g})">'
                 f"{escape(y_label)}</text></svg>")  # fmt: skip
    return "".join(parts)


def legend(lines: Sequence[Line]) -> str:
    """The labels of lines beside their colours."""
    rows = [
        f'<span><i class="l{line.colour}{" dash" if line.dashed else ""}"></i>{escape(line.label)}</span>'
        for line in lines
    ]
    return f'<div class="legend">{"".join(rows)}</div>'


def _points(line: Line, *, log: bool) -> list[tuple[float, float]]:
    pairs = zip(line.xs, line.ys, strict=True)
    return [(x, y) for x, y in pairs if math.isfinite(x) and math.isfinite(y) and (y > 0.0 or not log)]


def _x(axis: _Axis, x: float) -> float:
    return LEFT + (WIDTH - LEFT - RIGHT) * axis.map(x)


def _y(axis: _Axis, y: float) -> float:
    return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * axis.map(y)


def _line(line: Line, places: list[tuple[float, float]], values: list[tuple[float, float]]) -> list[str]:
    path = " ".join(f"{'M' if k == 0 else 'L'}{x:.1f} {y:.1f}" for k, (x, y) in enumerate(places))
    parts = []
    if line.filled and places:
        floor = HEIGHT - BOTTOM
        parts.append(
            f'<path class="f{line.colour}" d="{path} L{places[-1][0]:.1f} {floor:g} L{places[0][0]:.1f} {floor:g} Z"/>'
        )
    dash = " dash" if line.dashed else ""
    parts.append(f'<path class="l{line.colour}{dash}" d="{path}"/>')
    if len(places) <= 120:
        parts += [
            f'<circle class="p{line.colour}" cx="{x:.1f}" cy="{y:.1f}" r="{2.2 if len(places) < 60 else 1.4:g}">'
            f"<title>{escape(line.label)}: {value:.4g}</title></circle>"
            for (x, y), (_, value) in zip(places, values, strict=True)
        ]
    return parts


def _grid(across: _Axis, up: _Axis) -> list[str]:
    parts = []
    for value, label in up.ticks:
        y = _y(up, value)
        parts.append(f'<line class="grid" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6:g}" y="{y + 3.5:.1f}" text-anchor="end">{escape(label)}</text>')
    for value, label in across.ticks:
        x = _x(across, value)
        parts.append(
            f'<line class="tick" x1="{x:.1f}" x2="{x:.1f}" y1="{HEIGHT - BOTTOM:g}" y2="{HEIGHT - BOTTOM + 4:g}"/>'
        )
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 16:g}" text-anchor="middle">{escape(label)}</text>')
    return parts


def _linear(low: float, high: float) -> _Axis:
    span = (high - low) or abs(high) or 1.0
    step = 10.0 ** math.floor(math.log10(span / 4.0))
    step *= next(factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if span / (step * factor) <= 5.0)
    top = step * math.ceil((low + span) / step - 1e-9) if low == 0.0 else low + span
    first = math.ceil(low / step - 1e-9)
    ticks = [(k * step, f"{k * step:g}") for k in range(first, math.floor(top / step + 1e-9) + 1)]
    return _Axis(low, top, ticks, lambda value: (value - low) / (top - low))


def _logarithmic(low: float, high: float) -> _Axis:
    """From a power of ten, or two or five times one, to another."""
    steps = [factor * 10.0**power for power in range(-10, 8) for factor in (1.0, 2.0, 5.0)]
    bottom = max((step for step in steps if step <= low), default=steps[0])
    top = min((step for step in steps if step >= high and step > bottom), default=steps[-1])
    wide = top / bottom > 1e3
    inner = [step for step in steps if bottom <= step <= top and (not wide or f"{step:e}".startswith("1"))]
    width = math.log(top / bottom)
    return _Axis(bottom, top, [(step, f"{step:g}") for step in inner], lambda value: math.log(value / bottom) / width)


def _fixed(ticks: Sequence[tuple[float, str]]) -> _Axis:
    low, high = ticks[0][0], ticks[-1][0]
    return _Axis(low, high, list(ticks), lambda value: (value - low) / (high - low))
