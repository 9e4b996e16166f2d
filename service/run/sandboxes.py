"""The parent's side of sandboxes: a fork for every upload that a server sends. See :mod:`service.upload.forked`."""

from __future__ import annotations

import signal
import socket
from functools import partial

import structlog

from service.run.fork import Child, Parent
from service.upload import sandbox
from service.upload.sandbox import Job

__all__ = ["MAX_SANDBOXES", "SandboxForks"]

MAX_SANDBOXES = 32
"""Most sandboxes at a time; each server has one at most."""

log = structlog.get_logger("adverb.supervisor")


class SandboxForks:
    """Forks sandboxes, and kills those whose server does not wait for them any more.

    Parameters
    ----------
    parent : Parent
    """

    def __init__(self, parent: Parent) -> None:
        self._parent = parent
        self._running: dict[int, Child] = {}

    def start(self, job: Job, answer: socket.socket) -> None:
        """Fork a sandbox for a job; it writes its answer to a socket, whose other end the server has."""
        if len(self._running) >= MAX_SANDBOXES:
            log.warning("too many sandboxes; an upload is refused", limit=MAX_SANDBOXES)
            answer.close()
            return
        to = answer.fileno()
        try:
            child = self._parent.fork(
                partial(sandbox.run, job, to),
                name="adverb-sandbox",
                keep=(to,),
                on_end=lambda code: self._ended(child, answer, code),
                with_parent=signal.SIGKILL,
            )
        except OSError as err:  # no process or memory left
            log.warning("a sandbox cannot be forked; an upload is refused", problem=str(err))
            answer.close()
            return
        self._running[child.pid] = child
        self._parent.watch(answer, partial(self._abandoned, child, answer))

    def close(self) -> None:
        """Kill all sandboxes."""
        for child in self._running.values():
            child.signal(signal.SIGKILL)

    def _abandoned(self, child: Child, answer: socket.socket) -> None:
        """The server has closed its end: it has the answer, gave up, or ended."""
        self._parent.forget(answer)
        child.signal(signal.SIGKILL)

    def _ended(self, child: Child, answer: socket.socket, code: int) -> None:
        del self._running[child.pid]
        if code != 0 and answer.fileno() != -1:  # the server still waits
            log.warning("sandbox died", code=code)
        self._parent.forget(answer)
