"""Commands ``build`` and ``info``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from verbs.cli.options import Json, VerbArgument, open_verb
from verbs.cli.output import err, out, plain, print_json, progress
from verbs.units import quantity

if TYPE_CHECKING:
    from verbs.authoring.fit import Built

__all__ = ["build_command", "info_command"]


def build_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with verb.toml and its motion files.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; NAME.verb by default.")] = None,
    as_json: Json = False,
) -> None:
    """Build a verb from its source folder.

    Example: [bold]adverb build mocap/reach -o reach.verb[/]
    """
    from verbs.authoring.fit import build
    from verbs.io import artifact
    from verbs.quality.foot_contact import slide_rows
    from verbs.quality.leave_one_out import suggested_tail

    with progress() as report:
        built = build(folder, progress=report)
    path = output or Path(f"{built.verb.name}.verb")
    artifact.save(built.verb, path)
    for warning in built.warnings:
        err.print(f"[yellow]warning:[/] {plain(warning)}", soft_wrap=True)
    suggestion = suggested_tail(built.verb)
    if as_json:
        verb = built.verb
        print_json({"file": str(path), "name": verb.name, "examples": len(verb.examples), **verb.quality,
                     "mends": verb.provenance.get("mends", []), "feet": slide_rows(verb),
                     "warnings": list(built.warnings), "suggestions": [suggestion] * bool(suggestion)})  # fmt: skip
        return
    out.print(_build_table(built, path))
    if mends := built.verb.provenance.get("mends"):
        out.print(_mends_table(mends))
    if rows := slide_rows(built.verb):
        out.print(_feet_table(rows))
    if suggestion:
        out.print(f"suggestion: {plain(suggestion)}", soft_wrap=True)


def _build_table(built: Built, path: Path) -> Table:
    verb, quality = built.verb, built.verb.quality
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    unit = verb.measure.unit
    table.add_row("verb", f"{verb.name} → {path} ({path.stat().st_size / 1e6:.1f} MB)")
    table.add_row("examples", f"{len(verb.examples)}, {verb.intervals + 1} canonical keys, {len(verb.skeleton)} joints")
    for adverb in verb.adverbs:
        style = ", style" if adverb.style else ""
        table.add_row(f"  {adverb.name}", f"{adverb.minimum:.3f} to {adverb.maximum:.3f} {adverb.unit}{style}")
    table.add_row("domain", quality["domain"])
    table.add_row("condition", f"{quality['condition']:.3g} (radial system)")
    table.add_row("curves", f"within {quantity(quality['curve_error_max_m'])} of every joint at every source frame")
    table.add_row("chart", quality["chart_reason"])
    if "methods" in quality:
        table.add_row("worst stored", plain(built.worst_stored))
        table.add_row("at examples", f"error ≤ {quantity(quality['error_examples_max_m'], unit, 2)}")
        for name, found in quality["methods"].items():
            table.add_row(
                f"inside, {name}",
                f"error {quantity(found['error_mean_m'], unit)} mean, {quantity(found['error_max_m'], unit)} max, "
                f"Σ|w| ≤ {found['weight_sum_max']:.2f} over {quality['samples']} random points",
            )
    return table


def _mends_table(rows: list[dict[str, Any]]) -> Table:
    """What was found and done in each example."""
    table = Table(title="mends", title_justify="left")
    for column in ("example", "kind", "found", "done"):
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(plain(str(row[key])) for key in ("example", "kind", "found", "done")))
    return table


def _feet_table(rows: list[dict[str, Any]]) -> Table:
    """Slide and penetration of the feet in each example."""
    table = Table(title="feet of the examples, mm", title_justify="left")
    table.add_column("example", overflow="fold")
    for column in ("stances", "slide p90", "slide max", "penetration"):
        table.add_column(column, justify="right")
    for row in rows:
        figures = (row["slide_p90_m"], row["slide_max_m"], row["penetration_m"])
        shown = ("–" if figure is None else f"{1000 * figure:.1f}" for figure in figures)
        table.add_row(plain(row["example"]), str(row["stances"]), *shown)
    return table


def info_command(verb: VerbArgument, as_json: Json = False) -> None:
    """Describe a verb: adverbs, examples, domain, measured quality.

    Example: [bold]adverb info reach --json[/]
    """
    from verbs.blend.methods import default_method
    from verbs.runtime import describe

    loaded = open_verb(verb)
    if as_json:
        print_json(describe.describe(loaded))
        return
    table = Table(
        title=f"{loaded.name}: {loaded.description}" if loaded.description else loaded.name,
        title_justify="left",
    )
    for column in ("adverb", "from", "to", "unit", "meaning"):
        table.add_column(column, overflow="fold", justify="right" if column in ("from", "to") else "left")
    for k, adverb in enumerate(loaded.adverbs):
        measure = describe.own_measure_text(loaded, k)
        meaning = "; ".join(filter(None, [adverb.description, measure])) + (" (style)" if adverb.style else "")
        table.add_row(adverb.name, f"{adverb.minimum:.3f}", f"{adverb.maximum:.3f}", adverb.unit, meaning)
    out.print(table)
    low, high = loaded.keytimes[:, -1].min(), loaded.keytimes[:, -1].max()
    out.print(
        f"{len(loaded.examples)} examples of {low:.2f} to {high:.2f} s, {len(loaded.skeleton)} joints, "
        f"keytimes {', '.join(loaded.keytime_names)}{', looping' if loaded.looping else ''}; "
        f"default method {default_method(loaded)}"
    )
    for foot in describe.describe(loaded)["contacts"]:
        parts = ", ".join(f"{point['part']} {point['share']:.0%}" for point in foot["points"])
        out.print(
            f"{plain(foot['foot'])}: in contact {foot['share']:.0%} of the motion ({parts}), "
            f"{foot['intervals']} intervals in all examples"
        )
