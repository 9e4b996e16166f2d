"""Command ``gallery``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from verbs.cli.options import open_verb
from verbs.cli.output import print_json, progress

__all__ = ["gallery_command"]


def gallery_command(
    verbs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="VERB", help="Built-in names, .verb files or source folders; all built-in verbs without."
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the pictures and index.html.")
    ] = Path("gallery"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the list of files as JSON.")] = False,
) -> None:
    """Draw verbs over their adverbs: strips and grids of poses, and a page that shows them.

    Example: [bold]adverb gallery reach walk.verb -o gallery[/]
    """
    from verbs import library
    from verbs.figures.gallery import gallery  # matplotlib is needed by few commands

    sources = verbs or list(library.names())
    loaded = [open_verb(name) for name in sources]
    with progress() as report:
        paths = gallery(loaded, output, sources=sources, progress=report)
    if as_json:
        print_json([str(path) for path in paths])
        return
    for path in paths:
        typer.echo(path)
