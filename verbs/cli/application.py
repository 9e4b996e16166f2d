"""The application: its commands in order, and how errors become exit codes."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer

from verbs.cli.build import build_command, info_command
from verbs.cli.figures import figures_command
from verbs.cli.measure import measure_command
from verbs.cli.output import err, plain
from verbs.cli.pose import export_command, pose_command
from verbs.cli.refine import refine_command
from verbs.errors import VerbError

__all__ = ["app", "main", "run"]

app = typer.Typer(
    name="adverb",
    help="Example motions in, any motion in between out, with its measured error.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
)

_COMMANDS: dict[str, Callable[..., None]] = {
    "build": build_command,
    "info": info_command,
    "pose": pose_command,
    "measure": measure_command,
    "refine": refine_command,
    "export": export_command,
    "figures": figures_command,
}
for _name, _command in _COMMANDS.items():
    app.command(_name)(_command)


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
