"""Logging: one line per event on stderr, for people or as JSON; uvicorn and the library write through it too."""

from __future__ import annotations

import logging
import sys
from io import StringIO
from typing import TextIO

import structlog
from structlog.tracebacks import ExceptionDictTransformer
from structlog.typing import EventDict, ExcInfo, Processor, WrappedLogger

from service.settings import Settings
from service.tracing import trace_id

__all__ = ["configure"]

_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
"""Control characters, which could change a terminal or imitate a line of the log."""

_ESCAPES_OF_TEXT = {code: escape for code, escape in _ESCAPES.items() if chr(code) not in "\t\n"}
"""The same for texts of several lines."""


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
        _escape,
        structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=_write_traceback),
    ]
    if settings.log_json:
        # Without local variables: those of a request hold its key and its body.
        tracebacks = structlog.processors.ExceptionRenderer(ExceptionDictTransformer(show_locals=False))
        ending = [tracebacks, structlog.processors.JSONRenderer()]
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


def _escape(logger: WrappedLogger, name: str, event: EventDict) -> EventDict:
    """Escape control characters of values, which may be a client's; JSON does so itself."""
    del logger, name
    for key, value in event.items():
        if isinstance(value, str):
            several_lines = key in ("event", "exception", "stack")
            event[key] = value.translate(_ESCAPES_OF_TEXT if several_lines else _ESCAPES)
    return event


def _write_traceback(output: TextIO, exc_info: ExcInfo) -> None:
    """Write a traceback without local variables; the rich one takes seconds and shows them."""
    plain = StringIO()
    structlog.dev.plain_traceback(plain, exc_info)
    output.write(plain.getvalue().translate(_ESCAPES_OF_TEXT))


def _add_trace(logger: WrappedLogger, name: str, event: EventDict) -> EventDict:
    """Add the id of the current trace, by which logs are found from a trace."""
    del logger, name
    if (found := trace_id()) is not None:
        event["trace_id"] = found
    return event
