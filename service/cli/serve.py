"""Commands ``serve`` and ``worker``."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import DEFAULT_DATA, USER_ERROR, settings_of
from service.run import fork
from service.run.listener import CannotServe, folder_problem
from service.settings import Settings

__all__ = ["serve_command", "worker_command"]

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables by which linear algebra libraries take their number of threads."""


def serve_command(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one. [default: 8000]")] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder in which verbs are kept. [default: data, made here]")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Server processes that share the port. [default: 1]")] = None,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning or error. [default: info]")] = None,
    log_json: Annotated[bool | None, typer.Option("--log-json/--log-text", help="Format of log lines.")] = None,
    allow_public: Annotated[
        bool | None,
        typer.Option("--allow-public", help="Allow a public address without keys."),
    ] = None,
) -> None:
    """Serve verbs over HTTP.

    Every setting is also an environment variable (ADVERB_PORT, …; see the README); an option wins over it.

    Example: [bold]adverb serve --data verbs --port 8000[/]
    """
    settings = settings_of(
        host=host,
        port=port,
        data=data,
        workers=workers,
        log_level=log_level,
        log_json=log_json,
        allow_public=allow_public,
    )
    if settings.data is None:
        settings = settings.model_copy(update={"data": DEFAULT_DATA})
        DEFAULT_DATA.mkdir(exist_ok=True)
    _serve(settings)


def worker_command(
    name: Annotated[str | None, typer.Option(help="Name of this worker, the same at every start.")] = None,
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder in which verbs are kept.")] = None,
    nice: Annotated[int, typer.Option(min=0, max=19, help="By how much to lower its priority.")] = 10,
    parent: Annotated[int | None, typer.Option(hidden=True, help="Process whose end also ends the worker.")] = None,
) -> None:
    """Refine verbs for servers that share a database and artifacts with this worker.

    Example: [bold]ADVERB_DATABASE_URL=postgresql://… adverb worker --name worker-1[/]
    """
    settings = settings_of(data=data)
    if settings.data is None:
        settings = settings.model_copy(update={"data": DEFAULT_DATA})
    folder = settings.data
    needed = folder if None in (settings.database_url, settings.artifact_url) else None
    if needed is not None and (problem := folder_problem(needed)):
        typer.echo(f"error: {problem}; name the folder of the server (--data)", err=True)
        raise typer.Exit(USER_ERROR)
    os.nice(nice)  # before the imports, which take seconds
    from service.refinement.errors import JobError
    from service.refinement.worker import main as worker
    from service.run import logs
    from service.store.records import StoreError

    logs.configure(settings)
    try:
        worker.run(
            settings.database,
            settings.artifacts,
            executor_id=name or platform.node() or "worker",
            parent=parent,
            report=lambda text: typer.echo(text, err=True),
        )
    except (JobError, StoreError) as err:
        typer.echo(f"error: {err}", err=True)
        raise typer.Exit(USER_ERROR) from err


def _serve(settings: Settings) -> None:
    """Serve by a parent that forks all other processes, or in this one on systems where it cannot."""
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # before NumPy is imported: a parent has no threads
    if fork.AVAILABLE:
        from service.run.supervisor import serve
    else:
        from service.run.server import serve

    try:
        serve(settings, report=lambda text: typer.echo(text, err=True))
    except CannotServe as err:
        typer.echo(f"error: {err}", err=True)
        raise typer.Exit(USER_ERROR) from err
