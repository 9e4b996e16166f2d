"""What the children of the supervisor run, each after its fork."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from service.run.loads import Loads
from service.settings import Settings

__all__ = ["METRICS", "NICE", "refine", "serve"]

METRICS = "PROMETHEUS_MULTIPROC_DIR"
"""Environment variable with the folder of the metrics that several servers share."""

NICE = 10
"""By how much the priority of a refiner is lower than that of a server."""


def serve(
    settings: Settings,
    listener: socket.socket,
    parent: socket.socket,
    *,
    number: int,
    loads: Loads | None,
    metrics: Path | None,
) -> int:
    """Serve until SIGTERM; return the exit code.

    Parameters
    ----------
    settings : Settings
    listener : socket
        Bound socket, which several servers share.
    parent : socket
        Sends to the parent that the server is ready, why it cannot serve, and uploads.
    number : int
        Number of this server among several.
    loads : Loads or None
        Loads of several servers.
    metrics : Path or None
        Folder of the metrics of several servers.
    """
    from service.catalog.catalog import Catalog
    from service.run.listener import CannotServe
    from service.run.server import run
    from service.upload.forked import Forked

    def send(message: dict[str, Any]) -> None:
        parent.send(json.dumps(message).encode())

    def ready(catalog: Catalog) -> None:
        skipped = [(row.file, row.problem) for row in catalog.skipped]
        send({"ready": {"verbs": len(catalog.entries), "skipped": skipped}})

    if metrics is not None:
        _share_metrics(number, metrics)
    try:
        run(settings, listener, on_ready=ready, sandboxes=Forked(parent), loads=loads, number=number)
    except CannotServe as err:
        send({"failed": str(err)})
        return 1
    return 0


def refine(settings: Settings, name: str, report: Callable[[str], None]) -> int:
    """Refine until SIGTERM, at a low priority; return the exit code."""
    os.nice(NICE)
    from service.refinement.errors import JobError
    from service.refinement.worker.main import run
    from service.store.records import StoreError

    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    try:
        run(settings.database, settings.artifacts, executor_id=name, report=report)
    except (JobError, StoreError) as err:
        report(f"error: {err}")
        return 1
    return 0


def _share_metrics(number: int, folder: Path) -> None:
    """Keep metrics in files of a folder; a restarted server continues the counters of its number."""
    from prometheus_client import values

    os.environ[METRICS] = str(folder)
    values.ValueClass = values.MultiProcessValue(partial(int, number))  # type: ignore[no-untyped-call]
