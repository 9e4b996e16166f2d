"""Command ``measure``."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from verbs.cli.motion import print_motion
from verbs.cli.options import METHODS, Json, VerbArgument, open_verb
from verbs.cli.output import out, print_json, progress
from verbs.units import quantity

if TYPE_CHECKING:
    from verbs.quality.report import Quality
    from verbs.verb import Verb

__all__ = ["measure_command"]


def measure_command(
    verb: VerbArgument,
    method: Annotated[str, typer.Option("--method", help=f"all, or one of {METHODS}.")] = "all",
    grid: Annotated[int, typer.Option(min=5, max=401, help="Nodes on a side of the smoothness slices.")] = 61,
    feet: Annotated[bool, typer.Option("--feet", help="Also evaluate foot slide.")] = False,
    motion: Annotated[bool, typer.Option("--motion", help="Evaluate whole motions instead.")] = False,
    goals: Annotated[int, typer.Option(min=1, max=10_000, help="Number of random goals of --motion.")] = 60,
    as_json: Json = False,
) -> None:
    """Print the quality of one method, or of all: parametric error, smoothness, support by the examples, time.

    Support is 1 at an example, and 0.5 where an answer is as uncertain as an example predicted from the others.
    With --motion: feet, joints, balance, self-intersection and loops of whole motions, blends beside examples.

    Example: [bold]adverb measure reach --method rbf --json[/]
    """
    from verbs.blend.methods import usable
    from verbs.quality.report import quality_of, recommend

    loaded = open_verb(verb)
    if motion:
        print_motion(loaded, method, goals, as_json=as_json)
        return
    chosen = [method]
    if method == "all":  # without pseudo-examples, refined is rbf and hybrid is search
        chosen = [name for name in usable(loaded) if "refined" in loaded.bases or name not in ("refined", "hybrid")]
    with progress() as report:
        rows: list[Quality] = []
        for k, name in enumerate(chosen):
            report("quality", k, len(chosen))
            rows.append(quality_of(loaded, name, nodes=grid, slide=feet))
        report("quality", len(chosen), len(chosen))
    if as_json:
        found: dict[str, Any] = {"verb": loaded.name, "methods": {row.method: row.as_dict() for row in rows}}
        if len(rows) > 1:
            found["recommendation"] = recommend(rows, loaded.measure.unit)
        print_json(found)
        return
    out.print(_measure_table(loaded, rows))
    if feet:
        out.print(_slide_table(loaded, rows))
    if len(rows) > 1:
        out.print(recommend(rows, loaded.measure.unit))


def _measure_table(verb: Verb, rows: list[Quality]) -> Table:
    unit = verb.measure.unit
    heads = (
        "method",
        "error mean",
        "max",
        "mean, %",
        "max, %",
        "κ mean",
        "κ max",
        "zoom",
        "Σ|w| max",
        "support mean",
        "min",
        "µs",
    )
    table = Table(*heads, title=f"{verb.name}, {rows[0].domain}", caption=rows[0].grid, title_justify="left")
    for row in rows:
        table.add_row(
            row.method,
            quantity(row.error_mean_m, unit),
            quantity(row.error_max_m, unit),
            f"{row.error_mean_pct:.3g}",
            f"{row.error_max_pct:.3g}",
            f"{row.smoothness:.3g}",
            f"{row.smoothness_max:.3g}",
            f"{row.zoom_ratio:.2f}",
            f"{row.weight_sum_max:.2f}",
            f"{row.support_mean:.2f}",
            f"{row.support_min:.2f}",
            f"{row.query_us:.2f}",
        )
    return table


def _slide_table(verb: Verb, rows: list[Quality]) -> Table:
    """Millimetres; – where the skeleton has no toes."""
    table = Table("method", "median", "p90", "max", title=f"{verb.name}, foot slide, mm", title_justify="left")
    for row in rows:
        numbers = (row.slide_median_m, row.slide_p90_m, row.slide_max_m)
        table.add_row(row.method, *("–" if isnan(value) else f"{1000 * value:.1f}" for value in numbers))
    return table
