"""Sandboxes that the parent of this server forks from itself, which takes milliseconds.

The server sends the job and one end of a socket pair; the sandbox writes its answer to that end. The parent keeps a
copy of it: when the server closes the other end, or ends, the parent kills the sandbox.
"""

from __future__ import annotations

import asyncio
import socket

import orjson
import structlog

from service.upload.builder import MAX_ANSWER_BYTES
from service.upload.sandbox import Job

__all__ = ["Forked"]

log = structlog.get_logger("adverb.building")


class Forked:
    """Sandboxes of the parent process.

    Parameters
    ----------
    parent : socket
        To the parent; each message is received as one.
    """

    def __init__(self, parent: socket.socket) -> None:
        self._parent = parent

    async def prepare(self) -> None:
        """Do nothing: the parent is ready to fork."""

    async def work(self, job: Job) -> bytes:
        """Run a job in a sandbox, and return the line that it answers; empty where it dies before it does.

        Where this is cancelled, the sandbox is killed.
        """
        mine, its = socket.socketpair()
        try:
            with its:
                socket.send_fds(self._parent, [orjson.dumps({"job": job})], [its.fileno()])
        except OSError as err:  # the parent is gone, and this server ends too
            mine.close()
            log.warning("no sandbox can be started", problem=str(err))
            return b""
        reader, writer = await asyncio.open_unix_connection(sock=mine, limit=MAX_ANSWER_BYTES)
        try:
            return await reader.readline()
        except ConnectionError:
            return b""
        finally:
            writer.transport.abort()

    async def close(self) -> None:
        """Do nothing: the parent ends sandboxes together with this process."""
