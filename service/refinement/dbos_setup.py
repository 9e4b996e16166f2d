"""Setup of DBOS, which queues refinement jobs: names and settings that servers and workers share.

With SQLite DBOS uses the file ``jobs.db`` beside that of the store; in PostgreSQL the schema ``dbos``.
"""

from __future__ import annotations

import logging
from typing import Any

from dbos import DBOS, DBOSClient, DBOSConfig, DBOSPortableJSONSerializer
from dbos import error as problems
from sqlalchemy import make_url

__all__ = [
    "QUEUE",
    "RECOVERIES",
    "VERSION",
    "WORKFLOW",
    "config",
    "configure_logging",
    "connect",
    "prepare",
    "system_url",
]

NAME = "adverb"
WORKFLOW = "refine"
QUEUE = "refinements"

VERSION = "1"
"""Version of the steps of a job. Workers run only jobs of their own version."""

RECOVERIES = 1_000
"""Limit of DBOS's own count of starts, which is reset when a job is resumed; the store counts lost workers."""

POLL_S = 0.5
"""Polling interval of an idle worker, seconds."""


def system_url(database_url: str) -> str:
    """Address of DBOS's database, derived from that of the store."""
    url = make_url(database_url)
    if url.get_backend_name() != "sqlite":
        return url.set(drivername="postgresql").render_as_string(hide_password=False)
    assert url.database is not None  # the store has opened it
    folder = url.database.rpartition("/")[0]
    return f"sqlite:///{folder}/jobs.db"


def prepare(database_url: str) -> None:
    """Create or upgrade DBOS's tables, and register the queue; a client does neither by itself."""
    configure_logging()
    DBOS.migrate(system_url(database_url))
    client = connect(database_url)
    try:
        client.register_queue(QUEUE, worker_concurrency=1, polling_interval_sec=POLL_S, application_name=NAME)
    finally:
        client.destroy()


def connect(database_url: str) -> DBOSClient:
    """A client, which runs no jobs; its writes fail instead of waiting for an unreachable database."""
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


def configure_logging() -> None:
    """Route DBOS's log through ours, and drop the expected records of cancelled jobs."""
    logger = logging.getLogger("dbos")
    if not any(isinstance(one, logging.NullHandler) for one in logger.handlers):
        logger.addHandler(logging.NullHandler())  # DBOS adds its own handler only to a logger without any
        logger.addFilter(_is_unexpected)
    logger.setLevel(logging.WARNING)


def _is_unexpected(record: logging.LogRecord) -> bool:
    """Whether a log record is about something else than a cancelled job."""
    kind: Any = record.exc_info[0] if isinstance(record.exc_info, tuple) else None
    return kind is None or not issubclass(kind, problems.DBOSAwaitedWorkflowCancelledError)
