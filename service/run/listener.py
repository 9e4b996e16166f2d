"""The listening socket of a server, opened before anything is loaded, so that what is wrong is told at once."""

from __future__ import annotations

import ipaddress
import socket
import threading
import time
from collections.abc import Callable, Sequence
from itertools import chain, repeat

from service.settings import Settings

__all__ = ["CannotServe", "Patience", "check", "greeting", "listen"]


PATIENCE_S = (10.0, 20.0, 30.0)
"""Pauses between words about a long start; the last one again and again."""


class CannotServe(Exception):
    """The server cannot start; the message says why and what to do."""


class Patience:
    """Says now and then that a start takes its time, until anything else is said or it is over.

    Parameters
    ----------
    say : callable
        Told so, from a thread.
    pauses_s : sequence of float
    """

    def __init__(self, say: Callable[[str], None], pauses_s: Sequence[float] = PATIENCE_S) -> None:
        self._say, self._pauses_s, self._over = say, pauses_s, threading.Event()
        self._thread = threading.Thread(target=self._wait, name="patience", daemon=True)
        self._thread.start()

    def say(self, text: str) -> None:
        """Say something else."""
        self.end()
        self._say(text)

    def end(self) -> None:
        """Say no more."""
        self._over.set()
        self._thread.join()

    def _wait(self) -> None:
        started_s, why = time.monotonic(), "; kernels are compiled at the first start, which takes a minute or two"
        for pause_s in chain(self._pauses_s, repeat(self._pauses_s[-1])):
            if self._over.wait(pause_s):
                return
            self._say(f"starting, {time.monotonic() - started_s:.0f} s so far{why}")
            why = ""


def listen(settings: Settings, *, shared: bool = False) -> socket.socket:
    """A socket that is bound to the settings' host and port, and does not listen yet.

    Parameters
    ----------
    settings : Settings
    shared : bool
        Whether other processes of this server are bound to the same port. The kernel spreads connections over them by
        a hash of their addresses. One queue for all would be less even: whoever wakes first takes what is there, and
        a stream stays where it lands.

    Raises
    ------
    CannotServe
        The address is not known, is taken, or can be reached by others although there are no keys.
    """
    try:
        found = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as err:
        raise CannotServe(f"the host '{settings.host}' is not known: {err.strerror or err}") from err
    family, _, _, _, address = found[0]
    if not settings.allow_public and not all(_is_loopback(str(row[4][0])) for row in found):
        raise CannotServe(
            f"other machines can reach {settings.host}, and there are no keys yet: anyone could use this server; "
            "if that is what you want, say so: --allow-public, or ADVERB_ALLOW_PUBLIC=true"
        )
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if shared:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
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
    """Raise :class:`CannotServe` where there is no such data folder."""
    if settings.data is not None and not settings.data.is_dir():
        raise CannotServe(f"the data folder {settings.data} does not exist; make it, or name another (--data)")


def greeting(
    listener: socket.socket, verbs: int, skipped: Sequence[tuple[str, str]], *, processes: int = 1
) -> list[str]:
    """What a server says when it is ready: files that it cannot use, each with its problem, then where it is."""
    host, port = listener.getsockname()[:2]
    where = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    what = f"{verbs} verb{'s' * (verbs != 1)}" + f", {processes} processes" * (processes > 1)
    warnings = [f"warning: {file} is not served: {problem}" for file, problem in skipped]
    return [*warnings, f"Adverb is ready on {where} ({what}; docs at /docs)"]


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback
