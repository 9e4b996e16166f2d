"""Command ``figures``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from verbs.cli.output import progress

__all__ = ["figures_command"]


def figures_command(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for results.md and figures/.")] = Path("docs"),
    data: Annotated[
        Path | None, typer.Option(help="Folder of captured verb sources; the built-in verbs without it.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Coarse grids and built-in verbs, as a test.")] = False,
) -> None:
    """Generate the papers' tables and figures. Takes minutes.

    Example: [bold]adverb figures --data mocap -o docs[/]
    """
    from verbs.figures import figures  # matplotlib is needed by this command only

    with progress() as report:
        paths = figures(output, data=data, quick=quick, progress=report)
    for path in paths:
        typer.echo(path)
