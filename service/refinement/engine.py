"""Where jobs are queued: DBOS beside the store, with the names and settings that servers and workers share.

With SQLite it keeps a file of its own, ``jobs.db`` beside the store's; in PostgreSQL a schema of its own, ``dbos``.
"""

from __future__ import annotations

import logging
from typing import Any

from dbos import DBOS, DBOSClient, DBOSConfig, DBOSPortableJSONSerializer
from dbos import error as problems
from sqlalchemy import make_url

__all__ = ["QUEUE", "RECOVERIES", "VERSION", "WORKFLOW", "config", "connect", "prepare", "quiet", "system_url"]

NAME = "adverb"
WORKFLOW = "refine"
QUEUE = "refinements"

VERSION = "1"
"""Of the steps of a job. Raise it only where a worker could not go on from a step that an older one finished."""

RECOVERIES = 1_000
"""DBOS's own count of starts, which it sets back at every take-over; the store counts what matters."""

POLL_S = 0.5
"""How often an idle worker looks into the queue; more often costs processor time."""


def system_url(database_url: str) -> str:
    """Address of DBOS's database, from that of the store's."""
    url = make_url(database_url)
    if url.get_backend_name() != "sqlite":
        return url.set(drivername="postgresql").render_as_string(hide_password=False)
    assert url.database is not None  # the store has opened it
    folder = url.database.rpartition("/")[0]
    return f"sqlite:///{folder}/jobs.db"


def prepare(database_url: str) -> None:
    """Make DBOS's tables, or bring them up to date, and the queue: a client does not do so by itself."""
    quiet()
    DBOS.migrate(system_url(database_url))
    client = connect(database_url)
    try:
        client.register_queue(QUEUE, worker_concurrency=1, polling_interval_sec=POLL_S, application_name=NAME)
    finally:
        client.destroy()


def connect(database_url: str) -> DBOSClient:
    """A client, which never runs jobs; its writes fail instead of waiting for a database that is gone."""
    return DBOSClient(
        system_database_url=system_url(database_url),
        serializer=DBOSPortableJSONSerializer(),
        application_name=NAME,
        system_database_pool_size=2,
        retry_connection_errors=False,
    )


def config(database_url: str, executor_id: str) -> DBOSConfig:
    """Settings of a worker's DBOS."""
    return DBOSConfig(
        name=NAME,
        system_database_url=system_url(database_url),
        serializer=DBOSPortableJSONSerializer(),
        executor_id=executor_id,
        application_version=VERSION,
        log_level="WARNING",
        enable_otlp=False,
    )


def quiet() -> None:
    """Let DBOS log like everything else, instead of to a stream of its own, and nothing about what is no trouble."""
    logger = logging.getLogger("dbos")
    if not any(isinstance(one, logging.NullHandler) for one in logger.handlers):
        logger.addHandler(logging.NullHandler())  # with any handler there DBOS adds none
        logger.addFilter(_no_trouble)
    logger.setLevel(logging.WARNING)


def _no_trouble(record: logging.LogRecord) -> bool:
    """Whether a record is worth reading: that a job ended because it was cancelled is not."""
    kind: Any = record.exc_info[0] if isinstance(record.exc_info, tuple) else None
    return kind is None or not issubclass(kind, problems.DBOSAwaitedWorkflowCancelledError)
