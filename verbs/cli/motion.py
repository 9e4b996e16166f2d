"""Table of ``adverb measure --motion``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from verbs.cli.options import METHODS
from verbs.cli.output import out, print_json, progress
from verbs.errors import UnknownName

if TYPE_CHECKING:
    from verbs.quality.motion import Comparison, Figure, Figures
    from verbs.verb import Verb

__all__ = ["print_motion"]


def print_motion(verb: Verb, method: str, goals: int, *, as_json: bool) -> None:
    """Print the figures of the motions of examples and of blends; ``all`` stands for the verb's own method."""
    from verbs.quality.motion import compare

    if method != "all" and method not in METHODS.split(", "):
        raise UnknownName("method", method, METHODS.split(", "))
    with progress() as report:
        found = compare(verb, method=None if method == "all" else method, goals=goals, progress=report)
    if as_json:
        print_json(found.as_dict())
    else:
        out.print(_table(found))


def _table(found: Comparison) -> Table:
    from verbs.quality.motion import FIGURES

    sides = [found.examples, found.blends, *([] if found.planted is None else [found.planted])]
    heads = ("figure", "unit", "examples", f"{found.goals} blends", "planted")[: 2 + len(sides)]
    table = Table(*heads, "", title=f"{found.verb}, whole motions by {found.method}", title_justify="left")
    for figure in FIGURES:
        reason = found.blends.reasons.get(figure.key, found.examples.reasons.get(figure.key, ""))
        table.add_row(figure.name, figure.unit, *(_cell(figure, side) for side in sides), reason)
    return table


def _cell(figure: Figure, side: Figures) -> str:
    value = side.values[figure.key]
    return "–" if value is None else f"{figure.factor * value:.3g}"
