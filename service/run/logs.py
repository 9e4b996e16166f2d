"""Logging: one line per event on stderr, for people or as JSON; uvicorn and the library write through it too."""

from __future__ import annotations

import logging
import sys

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from service.settings import Settings
from service.tracing import trace_id

__all__ = ["configure"]


def configure(settings: Settings) -> None:
    """Set up logging of this process; called once at start, never on import."""
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    if settings.traces_url is not None:
        shared.append(_add_trace)
    ending: list[Processor] = [
        structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(),
            exception_formatter=structlog.dev.plain_traceback,  # the rich one takes seconds, and shows what was sent
        )
    ]
    if settings.log_json:
        ending = [structlog.processors.dict_tracebacks, structlog.processors.JSONRenderer()]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelName(settings.log_level.upper())),
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,  # tests configure more than once
    )
    output = logging.StreamHandler(sys.stderr)
    output.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *ending],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [output]
    root.setLevel(settings.log_level.upper())
    # numba and asyncio log internals at debug level, which would hide the log of Adverb.
    for name in ("numba", "asyncio"):
        logging.getLogger(name).setLevel(logging.WARNING)


def _add_trace(logger: WrappedLogger, name: str, event: EventDict) -> EventDict:
    """Add the id of the current trace, by which logs are found from a trace."""
    del logger, name
    if (found := trace_id()) is not None:
        event["trace_id"] = found
    return event
