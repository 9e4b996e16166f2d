"""The sending side of a WebSocket: text messages wait in order, up to a bound; poses are sent at once or dropped."""

from __future__ import annotations

from collections import deque
from collections.abc import Coroutine, MutableMapping
from typing import Any

import anyio
import orjson
from starlette.types import Send

from service.stream.transport import Sockets

__all__ = ["TOO_SLOW", "Connection", "text"]

TOO_SLOW = 4008
"""Close code of a client that does not read."""


def text(message: dict[str, Any]) -> str:
    """A text message as it is sent."""
    return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def _now(sending: Coroutine[Any, Any, None]) -> bool:
    """Run a ``send`` that may take effect at once or not at all; whether it did.

    The server's ``send`` waits for room before it writes anything. So it is taken one step: it ends there, having
    written everything, or it waits, having written nothing, and is dropped. A test holds uvicorn to that.
    """
    try:
        sending.send(None)
    except StopIteration:
        return True
    sending.close()
    return False


class Connection:
    """A WebSocket, seen from the side that sends.

    Parameters
    ----------
    send : callable
        ASGI's.
    scope : anyio.CancelScope
        Cancelled to end the connection; ``ending`` says with which code and why.
    socket : Sockets, optional
        A shorter way for poses.
    """

    def __init__(self, send: Send, scope: anyio.CancelScope, socket: Sockets | None = None) -> None:
        self._send, self._scope, self._socket, self.gone = send, scope, socket, False
        self.ending: tuple[int, str] | None = None
        self.waiting: deque[str] = deque()

    def end(self, code: int, reason: str) -> None:
        """End it; the endpoint that runs it sends the close frame."""
        if self.ending is None:
            self.ending = code, reason
            self._scope.cancel()

    def say(self, message: str, room: int) -> None:
        """Send a text message now, or after those that wait, which may be so many."""
        if len(self.waiting) >= room:
            self.end(TOO_SLOW, f"{room} messages wait to be read")
            return
        self.waiting.append(message)
        self.flush()

    def flush(self) -> bool:
        """Send what waits; whether nothing is left."""
        while self.waiting:
            if not self._try({"type": "websocket.send", "text": self.waiting[0]}):
                return False
            self.waiting.popleft()
        return True

    def post(self, message: bytes) -> bool:
        """Send a binary message now or not at all; whether it was sent."""
        if self.ending is not None or (self.waiting and not self.flush()):
            return False
        if self._socket is None:
            return self._try({"type": "websocket.send", "bytes": message})
        try:
            return self._socket.post(message)
        except ConnectionError:  # its endpoint will notice
            self.gone = True
            return False

    def _try(self, message: MutableMapping[str, Any]) -> bool:
        if self.ending is not None:
            return False
        try:
            return _now(self._send(message))  # type: ignore[arg-type]
        except Exception:  # in one of several ways; its endpoint will notice
            self.gone = True
            return False
