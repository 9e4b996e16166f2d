"""Command ``load``: the load tester, which is part of the Python client."""

from __future__ import annotations

import importlib.util

import typer

from service.cli.options import USER_ERROR

__all__ = ["PASS_ON", "load_command"]

PASS_ON = {"allow_extra_args": True, "ignore_unknown_options": True}


def load_command(context: typer.Context) -> None:
    """Load a server with streams and requests, open loop, and report it; needs adverb-client.

    Profiles: arena, crowd, dashboard, or a TOML file (docs/load.md). "adverb load --help" lists all options;
    "adverb load compare A.json B.json" compares two reports.

    Example: [bold]adverb load --profile arena --html arena.html[/]
    """
    if importlib.util.find_spec("adverb_load") is None:
        typer.echo(
            "error: the load tester is part of adverb-client, which is not installed; pip install ./clients/python, "
            "or the adverb_client wheel of this release",
            err=True,
        )
        raise typer.Exit(USER_ERROR)
    from adverb_load.command import main

    raise typer.Exit(main(context.args))
