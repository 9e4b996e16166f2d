"""Shared by all figures: an empty figure, the colours of methods, and saving."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from verbs.errors import VerbError

__all__ = ["COLOURS", "MARKERS", "SHOWN", "canvas", "legend_below", "plain", "require", "save", "shrink"]

SHOWN = ("barycentric", "knn", "inverse", "rbf", "corrected")
"""Methods on maps and charts: the four of seed 2, and ``corrected``. ``perdof`` has the weights of ``rbf``."""

# Okabe and Ito's palette, safe for colour blindness; and markers, distinct without colour.
COLOURS = {
    "barycentric": "#E69F00",
    "knn": "#56B4E9",
    "inverse": "#D55E00",
    "rbf": "#0072B2",
    "corrected": "#009E73",
    "refined": "#CC79A7",
    "search": "#7F7F7F",
    "hybrid": "#000000",
}
MARKERS = {"barycentric": "s", "knn": "^", "inverse": "D", "rbf": "o", "corrected": "*"}


def require() -> None:
    """Raise :class:`VerbError` where matplotlib is missing."""
    try:
        import matplotlib.figure as _  # noqa: F401 - only whether it is there
    except ImportError as err:
        raise VerbError("drawing needs matplotlib: pip install 'adverb[figures]'") from err


def canvas(width: float, height: float, *, title: str = "") -> Any:
    """Empty figure of a size in inches, laid out so that nothing overlaps."""
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=12)
    return figure


def plain(width: float, height: float, *, paper: str) -> Any:
    """Empty figure of a size in inches without any layout, for drawings that place everything themselves."""
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor=paper)
    FigureCanvasAgg(figure)
    return figure


def legend_below(figure: Any, axes: Any, columns: int, *, scale: float = 1.0) -> None:
    """Put the legend of some axes below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, fontsize=9, frameon=False, markerscale=scale
    )


def save(figure: Any, path: Path, *, dpi: int = 110) -> Path:
    """Write a picture; return its path."""
    figure.savefig(path, dpi=dpi)
    figure.clear()
    return shrink(path)


def shrink(path: Path) -> Path:
    """Convert a PNG to a palette, a third of the bytes of true colour; return its path."""
    from PIL import Image

    with Image.open(path) as picture:
        flat = picture.convert("RGB").quantize(255, dither=Image.Dither.NONE)
    flat.save(path, optimize=True)
    return path
