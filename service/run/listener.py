"""The listening socket of a server, bound before anything is loaded, so that a wrong address is reported at once."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from pathlib import Path

from service import tracing
from service.settings import Settings

__all__ = ["CannotServe", "check", "folder_problem", "greeting", "listen"]


class CannotServe(Exception):
    """The server cannot start; the message names the problem and what to do."""


def listen(settings: Settings) -> socket.socket:
    """A socket that is bound to the settings' host and port, and does not listen yet.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    CannotServe
        The address is unknown or in use, or other machines can reach it although there are no keys.
    """
    try:
        found = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as err:
        raise CannotServe(f"the host '{settings.host}' is not known: {err.strerror or err}") from err
    family, _, _, _, address = found[0]
    if settings.public and not settings.allow_public and not _has_keys(settings):
        raise CannotServe(
            f"other machines can reach {settings.host}, and there are no keys yet: anyone could use this server; "
            "make a key (adverb keys create --scope pose), or allow that with --allow-public or "
            "ADVERB_ALLOW_PUBLIC=true"
        )
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
    except OSError as err:
        listener.close()
        raise CannotServe(
            f"port {settings.port} on {settings.host} cannot be used: {err.strerror or err}; "
            "stop what uses it, or choose another (--port, ADVERB_PORT; 0 takes a free one)"
        ) from err
    return listener


def check(settings: Settings) -> None:
    """Raise :class:`CannotServe` if the data folder is missing or a file, or packages for traces are missing."""
    if settings.data is not None and (problem := folder_problem(settings.data)):
        raise CannotServe(f"{problem}; create the folder, or name another one (--data)")
    try:
        tracing.check(settings)
    except tracing.MissingPackage as err:
        raise CannotServe(str(err)) from err


def folder_problem(data: Path) -> str | None:
    """Why a path cannot be the data folder; None if it can."""
    if data.is_dir():
        return None
    if data.exists():
        return f"{data} is a file, and --data is the folder that holds verbs"
    return f"the data folder {data} does not exist"


def greeting(
    listener: socket.socket, verbs: int, skipped: Sequence[tuple[str, str]], *, processes: int = 1
) -> list[str]:
    """Lines for a server that is ready: files that it cannot use, each with its problem, then its address."""
    host, port = listener.getsockname()[:2]
    where = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    what = f"{verbs} verb{'s' * (verbs != 1)}" + f", {processes} processes" * (processes > 1)
    warnings = [f"warning: {file} is not served: {problem}" for file, problem in skipped]
    return [*warnings, f"Adverb is ready on {where} ({what}; docs at /docs)"]


def _has_keys(settings: Settings) -> bool:
    """Whether requests to a public address need a key, and one can exist.

    Where the database cannot be reached, every request needs a key until it can.
    """
    if settings.keys == "off":
        return False
    if settings.keys == "required" or settings.jwt_jwks is not None:
        return True
    if settings.data is None and settings.database_url is None:
        return False
    from service.store.keys import open_keys  # imported here: it takes time, and most servers are not public
    from service.store.records import StoreError, StoreUnavailable

    try:
        store = open_keys(settings.database)
        try:
            return any(key.valid_at(time.time()) for key in store.listed())
        finally:
            store.close()
    except StoreUnavailable:
        return True
    except StoreError as err:
        raise CannotServe(str(err)) from err
