"""Command ``refine``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from verbs.cli.options import Json, VerbArgument, open_verb
from verbs.cli.output import out, print_json, progress

__all__ = ["refine_command"]


def refine_command(
    verb: VerbArgument,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; NAME.verb by default.")] = None,
    target_error: Annotated[float, typer.Option(min=0, help="Stop at this largest error, % of the diagonal.")] = 0.1,
    max_pseudo: Annotated[int, typer.Option(min=1, max=2000, help="Largest number of pseudo-examples.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search points.")] = 0,
    radii: Annotated[
        str, typer.Option(help="local keeps the radii of earlier centers; global computes all again.")
    ] = "local",
    planes: Annotated[str, typer.Option(help="frozen keeps the fitted planes; refit fits them again.")] = "frozen",
    as_json: Json = False,
) -> None:
    """Insert pseudo-examples where the error of a verb is largest, for the methods refined and hybrid.

    Example: [bold]adverb refine arm3 --max-pseudo 100 -o arm3_refined.verb[/]
    """
    from verbs import refine as refining
    from verbs.io import artifact

    loaded = open_verb(verb)
    rules = refining.Rules(target_error / 100.0, max_pseudo, seed, radii=radii, planes=planes)
    curve: list[tuple[int, float, float]] = []
    with progress() as report:
        for step in refining.refine(loaded, rules):
            curve.append((step.pseudo, 100 * step.after.mean, 100 * step.after.largest))
            report("pseudo-examples", step.pseudo, max_pseudo)
    path = output or Path(f"{loaded.name}.verb")
    artifact.save(refining.with_basis(loaded, step.basis, rules, step.mark), path)
    if as_json:
        fields = ("pseudo", "error_mean_pct", "error_max_pct")
        rows = [dict(zip(fields, point, strict=True)) for point in curve]
        print_json({"file": str(path), "stopped": step.mark.stopped, "curve": rows})
        return
    table = Table("pseudo-examples", "mean, %", "max, %", title=f"{loaded.name} → {path}", title_justify="left")
    for k, (pseudo, mean, largest) in enumerate(curve):
        if k in {0, len(curve) - 1} or pseudo in {1, 2, 5, 10, 20, 50, 100, 200, 500, 1000}:
            table.add_row(str(pseudo), f"{mean:.3f}", f"{largest:.3f}")
    out.print(table)
    out.print(f"stopped: {step.mark.stopped}")
