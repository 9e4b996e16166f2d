"""The command ``adverb`` with everything in it: the library's commands and ``serve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from service.settings import Settings
from verbs import cli

__all__ = ["main"]

USER_ERROR = 1


def main() -> None:
    """Run the command line."""
    cli.run(cli.app)


@cli.app.command("serve")
def serve_command(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one. [default: 8000]")] = None,
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder with built verbs (*.verb).")] = None,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning or error. [default: info]")] = None,
    log_json: Annotated[bool | None, typer.Option("--log-json/--log-text", help="How to log.")] = None,
    allow_public: Annotated[
        bool | None,
        typer.Option("--allow-public", help="Listen where other machines can reach it, although there are no keys."),
    ] = None,
) -> None:
    """Serve verbs over HTTP.

    Every setting is also an environment variable (ADVERB_PORT, …; see the README); an option wins over it.

    Example: [bold]adverb serve --data verbs --port 8000[/]
    """
    options: dict[str, Any] = {
        "host": host,
        "port": port,
        "data": data,
        "log_level": log_level,
        "log_json": log_json,
        "allow_public": allow_public,
    }
    try:
        settings = Settings(**{name: value for name, value in options.items() if value is not None})
    except ValidationError as err:
        for row in err.errors():
            name = str(row["loc"][0]) if row["loc"] else "settings"
            typer.echo(f"error: ADVERB_{name.upper()} (--{name.replace('_', '-')}): {row['msg']}", err=True)
        raise typer.Exit(USER_ERROR) from err
    from service import server  # a fifth of a second that the other commands need not wait for

    try:
        server.serve(settings, say=lambda text: typer.echo(text, err=True))
    except server.CannotServe as err:
        typer.echo(f"error: {err}", err=True)
        raise typer.Exit(USER_ERROR) from err
