"""The application: its commands in order, and how errors become exit codes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from verbs.cli.build import build_command, info_command
from verbs.cli.clips import mirror_command, resample_command, trim_command
from verbs.cli.figures import figures_command
from verbs.cli.gallery import gallery_command
from verbs.cli.init import init_command
from verbs.cli.map import map_command
from verbs.cli.measure import measure_command
from verbs.cli.output import err, plain
from verbs.cli.pose import export_command, pose_command
from verbs.cli.refine import refine_command
from verbs.cli.suggest import suggest_command
from verbs.cli.vmc import vmc_command
from verbs.errors import VerbError

__all__ = ["app", "main", "run"]

app = typer.Typer(
    name="adverb",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="rich",
)

_COMMANDS: dict[str, Callable[..., None]] = {
    "init": init_command,
    "build": build_command,
    "info": info_command,
    "pose": pose_command,
    "measure": measure_command,
    "suggest": suggest_command,
    "refine": refine_command,
    "export": export_command,
    "map": map_command,
    "vmc": vmc_command,
    "mirror": mirror_command,
    "trim": trim_command,
    "resample": resample_command,
    "figures": figures_command,
    "gallery": gallery_command,
}
for _name, _command in _COMMANDS.items():
    app.command(_name)(_command)


def _version(wanted: bool) -> None:
    """Print the version and exit."""
    if wanted:
        from importlib import metadata

        typer.echo(f"adverb {metadata.version('adverb')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Example motions in, any motion in between out, with its measured error.

    Exit codes: 0 success, 1 user error, 2 wrong usage. Results go to stdout, progress and warnings to stderr.

    Example: [bold]adverb pose arm3 --at x=0.5,y=0.2 --json[/]
    """


def main() -> None:
    """Run the command line; the service adds its own commands before it does."""
    run(app)


def run(application: typer.Typer) -> None:
    """Run an application: library errors become one message and exit code 1."""
    try:
        application()
    except VerbError as problem:
        err.print(f"[bold red]error:[/] {plain(str(problem))}", soft_wrap=True)
        sys.exit(1)
