"""Command ``refine``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from verbs.cli.options import Json, VerbArgument, open_verb
from verbs.cli.output import out, print_json, progress
from verbs.errors import UnknownName

if TYPE_CHECKING:
    from verbs.refine import Rules
    from verbs.refine_quality import Comparison
    from verbs.verb import Verb

__all__ = ["refine_command"]

AIMS = ("quality", "error")


def refine_command(
    verb: VerbArgument,
    aim: Annotated[str | None, typer.Option("--for", help="quality or error.", show_default="see above")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; NAME.verb by default.")] = None,
    target_error: Annotated[
        float | None,
        typer.Option(min=0, help="For error: stop at this largest one, % of the diagonal.", show_default="0.1"),
    ] = None,
    max_pseudo: Annotated[
        int | None,
        typer.Option(min=1, max=2000, help="Most pseudo-examples.", show_default="8 for quality, 200 for error"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search points.")] = 0,
    radii: Annotated[
        str | None,
        typer.Option(
            help="For error: local keeps the radii of earlier centers; global computes all again.",
            show_default="local",
        ),
    ] = None,
    planes: Annotated[
        str | None,
        typer.Option(help="For error: frozen keeps the fitted planes; refit fits them again.", show_default="frozen"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Insert pseudo-examples where a verb is worst.

    For quality: where its motion is worst, into the basis of the method corrected, which stays exact. For error: where
    its error is largest, for the methods refined and hybrid. Quality is the default of verbs whose default method is
    corrected, unless an option for error is given.

    Example: [bold]adverb refine reach -o calmer.verb[/]
    """
    from verbs.blend.methods import default_method
    from verbs.refine import Rules

    loaded = open_verb(verb)
    if aim is None:
        exact = default_method(loaded) == "corrected" and target_error is None and radii is planes is None
        aim = "quality" if exact else "error"
    path = output or Path(f"{loaded.name}.verb")
    if aim == "quality":
        _for_quality(loaded, path, max_pseudo or 8, seed, as_json=as_json)
    elif aim == "error":
        share = (0.1 if target_error is None else target_error) / 100.0
        rules = Rules(share, max_pseudo or 200, seed, radii=radii or "local", planes=planes or "frozen")
        _for_error(loaded, path, rules, as_json=as_json)
    else:
        raise UnknownName("aim", aim, AIMS)


def _for_error(verb: Verb, path: Path, rules: Rules, *, as_json: bool) -> None:
    from verbs import refine as refining
    from verbs.io import artifact

    curve: list[tuple[int, float, float]] = []
    with progress() as report:
        for step in refining.refine(verb, rules):
            curve.append((step.pseudo, 100 * step.after.mean, 100 * step.after.largest))
            report("pseudo-examples", step.pseudo, rules.max_pseudo)
    artifact.save(refining.with_basis(verb, step.basis, rules, step.mark), path)
    if as_json:
        fields = ("pseudo", "error_mean_pct", "error_max_pct")
        rows = [dict(zip(fields, point, strict=True)) for point in curve]
        print_json({"file": str(path), "for": "error", "stopped": step.mark.stopped, "curve": rows})
        return
    table = Table("pseudo-examples", "mean, %", "max, %", title=f"{verb.name} → {path}", title_justify="left")
    for k, (pseudo, mean, largest) in enumerate(curve):
        if k in {0, len(curve) - 1} or pseudo in {1, 2, 5, 10, 20, 50, 100, 200, 500, 1000}:
            table.add_row(str(pseudo), f"{mean:.3f}", f"{largest:.3f}")
    out.print(table)
    out.print(f"stopped: {step.mark.stopped}")


def _for_quality(verb: Verb, path: Path, max_pseudo: int, seed: int, *, as_json: bool) -> None:
    from verbs import refine_quality
    from verbs.io import artifact

    rules = refine_quality.Rules(max_pseudo=max_pseudo, seed=seed)
    rows = []
    with progress() as report:
        for step in refine_quality.refine(verb, rules):
            rows.append({"pseudo": step.pseudo, "cost_mean": step.after.mean, "cost_p95": step.after.p95,
                         "problem": step.problem})  # fmt: skip
            report("pseudo-examples", step.pseudo, rules.max_pseudo)
    refined = refine_quality.with_basis(verb, step.basis, rules, step.mark)
    artifact.save(refined, path)
    found = refine_quality.compare(verb, refined, seed)
    if as_json:
        print_json({"file": str(path), "for": "quality", "stopped": step.mark.stopped, "curve": rows,
                    "comparison": found.to_json()})  # fmt: skip
        return
    out.print(_quality_table(found, f"{verb.name} → {path}, {step.pseudo} pseudo-examples"))
    out.print(f"{found.better_ratio:.0%} of the goals are better by a tenth, {found.worse_ratio:.0%} worse")
    out.print("better" if found.better else f"not better: {', '.join(found.reasons)}")
    out.print(f"stopped: {step.mark.stopped}")


def _quality_table(found: Comparison, title: str) -> Table:
    from verbs.refine_quality.judge import ROWS

    table = Table(f"{found.goals} held-out goals", "unit", "before", "after", title=title, title_justify="left")
    for key, name, unit, factor in ROWS:
        pair = (getattr(found.now, key), getattr(found.new, key))
        table.add_row(name, unit, *("–" if value is None else f"{factor * value:.3g}" for value in pair))
    return table
