"""Commands ``backup`` and ``restore``."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from service.cli.options import DEFAULT_DATA, USER_ERROR, settings_of
from verbs.cli.output import progress

__all__ = ["backup_command", "restore_command"]


def backup_command(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write, .tar.")],
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the server. [default: data]")] = None,
) -> None:
    """Save a data folder with its SQLite databases to one file, also while it is served.

    For PostgreSQL use pg_dump, and for a bucket its own tools.

    Example: [bold]adverb backup --data data -o adverb-monday.tar[/]
    """
    from service.store.backup import backup
    from service.store.records import StoreError

    settings = settings_of(data=data)
    if settings.database_url is not None or settings.artifact_url is not None:
        _fail("ADVERB_DATABASE_URL or ADVERB_ARTIFACT_URL is set; save those with pg_dump and the tools of the bucket")
    try:
        with progress() as report:
            summary = backup(
                settings.data or DEFAULT_DATA, output, report=lambda done, total: report("saving", done, total)
            )
    except StoreError as err:
        _fail(str(err))
    size = f"{summary.size_bytes / 1e6:.1f} MB"
    typer.echo(f"{output}: {summary.versions} versions, {summary.artifacts} artifacts, {size}", err=True)


def restore_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of adverb backup.")],
    data: Annotated[Path, typer.Option(metavar="DIR", help="New folder to write.")],
) -> None:
    """Restore a backup into a new data folder, and check every artifact.

    Example: [bold]adverb restore adverb-monday.tar --data restored[/]
    """
    from service.store.backup import restore
    from service.store.records import StoreError

    try:
        with progress() as report:
            summary = restore(file, data, report=lambda done, total: report("restoring", done, total))
    except StoreError as err:
        _fail(str(err))
    made = datetime.fromtimestamp(summary.created_at_s, UTC).strftime("%Y-%m-%d %H:%M UTC")
    counts = f"{summary.versions} versions, {summary.artifacts} artifacts"
    typer.echo(f"{data}: {counts} of {made}, all checked; start it with adverb serve --data {data}", err=True)


def _fail(problem: str) -> NoReturn:
    typer.echo(f"error: {problem}", err=True)
    raise typer.Exit(USER_ERROR)
