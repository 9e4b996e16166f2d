"""Command ``init``: a proposed ``verb.toml`` for a folder of clips."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from verbs.cli.options import Json
from verbs.cli.output import err, out, plain, print_json, progress
from verbs.errors import OutOfRange

if TYPE_CHECKING:
    from verbs.proposal.result import Proposal

__all__ = ["init_command"]


def init_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with the clips.")],
    effector: Annotated[str | None, typer.Option(help="Joint whose position is measured.")] = None,
    measure: Annotated[str | None, typer.Option(help="joint_position, jump or root_velocity.")] = None,
    annotated: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE@T,T,…", help="Keytimes of a clip in seconds, e.g. a.bvh@0,1.2,2.4. May be repeated."
        ),
    ] = None,
    keytime_names: Annotated[str | None, typer.Option(metavar="NAME,…", help="Names of the keytimes given.")] = None,
    style_csv: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV with the header file,NAME,…")] = None,
    pattern: Annotated[
        str | None, typer.Option(help="Style adverbs from file names, e.g. '{}_{tired:float}_{}.bvh'.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of length of the files; guessed by default.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the verb; that of the folder by default.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing verb.toml.")] = False,
    as_json: Json = False,
) -> None:
    """Propose a verb.toml for a folder of clips: keytimes, adverbs, unit, what does not belong.

    Example: [bold]adverb init clips --annotated far_left.bvh@0,1.1,2.3[/]
    """
    from verbs.conventions import METRES_PER_UNIT
    from verbs.errors import SourceError, UnknownName
    from verbs.proposal.measures import ADVERBS
    from verbs.proposal.propose import propose, write
    from verbs.proposal.result import Options

    if unit is not None and unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    if measure is not None and measure not in ADVERBS:
        raise UnknownName("measure", measure, ADVERBS)
    if (folder / "verb.toml").exists() and not force:
        raise SourceError(folder / "verb.toml", "exists already; add --force to replace it")
    names = tuple(part.strip() for part in keytime_names.split(",")) if keytime_names else ()
    options = Options(effector, measure, unit, name, dict(map(_annotation, annotated or [])), names, style_csv, pattern)
    with progress() as report:
        proposal = propose(folder, options, progress=report)
    path = write(proposal, folder, force=force)
    if as_json:
        print_json({"file": str(path), **proposal.report()})
        return
    _print(proposal, path)


def _annotation(text: str) -> tuple[str, tuple[float, ...]]:
    """File and keytimes of ``FILE@0.0,1.2,2.4``."""
    file, _, listing = text.rpartition("@")
    try:
        times = tuple(float(part) for part in listing.split(","))
    except ValueError:
        times = ()
    if not file or not times:
        raise OutOfRange(f"'{text}' is not an annotation; write FILE@0.0,1.2,2.4 with seconds")
    return file, times


def _print(proposal: Proposal, path: Path) -> None:
    """The proposal as a table; what is excluded goes to stderr."""
    head = proposal.head
    kept = [row for row in proposal.rows if not row.excluded]
    out.print(f"{plain(str(path))}: {len(kept)} clips, measure {head.measure}")
    for key in ("unit", "measure", "keytimes", "chart"):
        if head.evidence.get(key):
            out.print(f"  {key}: {plain(head.evidence[key])}", soft_wrap=True)
    table = Table()
    table.add_column("clip", overflow="fold")
    for name in (*head.keytime_names, *(adverb[0] for adverb in head.adverbs), "left out"):
        table.add_column(plain(name), justify="right")
    for row in kept:
        times = (f"{t:.2f}{'' if sure == 1.0 else f' ({sure:.2f})'}"
                 for t, sure in zip(row.marks, row.keytimes.confidence, strict=True))  # fmt: skip
        left = proposal.left_out_deg.get(row.file)
        table.add_row(plain(row.file), *times, *(f"{value:.3f}" for value in row.values),
                      "–" if left is None else f"{left:.1f}°")  # fmt: skip
    out.print(table)
    out.print("Keytimes in seconds, with the confidence of those that are not given; left out: joint error of the clip "
              "predicted from the others.", soft_wrap=True)  # fmt: skip
    for row in proposal.rows:
        if row.excluded:
            err.print(f"[yellow]excluded:[/] {plain(row.file)} {plain(row.excluded)}", soft_wrap=True)
        for remark in row.remarks:
            err.print(f"[yellow]note:[/] {plain(row.file)}: {plain(remark)}", soft_wrap=True)
    for odd in proposal.refused:
        err.print(f"[yellow]excluded:[/] {plain(odd.name)} {plain(odd.problem)}; {plain(odd.advice)}", soft_wrap=True)
    if proposal.problem:
        err.print(f"[yellow]warning:[/] this does not build yet: {plain(proposal.problem)}", soft_wrap=True)
