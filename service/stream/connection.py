"""The sending side of a WebSocket: text messages wait in order, up to a bound; poses are sent at once or dropped."""

from __future__ import annotations

from collections import deque
from collections.abc import Coroutine, MutableMapping
from typing import Any

import anyio
import orjson
from starlette.types import Send

from service.stream.transport import StreamProtocol

__all__ = ["TOO_SLOW", "Connection", "text"]

TOO_SLOW = 4008
"""Close code of a client that does not read."""


def text(message: dict[str, Any]) -> str:
    """JSON of a text message."""
    return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def _run_once(sending: Coroutine[Any, Any, None]) -> bool:
    """Run a ``send`` coroutine for one step; return whether it finished.

    uvicorn's ``send`` waits for buffer space before it writes anything. After one step it either has written the whole
    message and finished, or has written nothing and is closed here. A test checks that uvicorn behaves so.
    """
    try:
        sending.send(None)
    except StopIteration:
        return True
    sending.close()
    return False


class Connection:
    """The sending side of a WebSocket.

    Parameters
    ----------
    send : callable
        ASGI's.
    scope : anyio.CancelScope
        Cancelled to close the connection; ``ending`` holds code and reason.
    transport : StreamProtocol, optional
        Fast path for pose messages.
    """

    def __init__(self, send: Send, scope: anyio.CancelScope, transport: StreamProtocol | None = None) -> None:
        self._send, self._scope, self._transport, self.lost = send, scope, transport, False
        self.ending: tuple[int, str] | None = None
        self.pending: deque[str] = deque()

    def end(self, code: int, reason: str) -> None:
        """Close the connection; its endpoint sends the close frame."""
        if self.ending is None:
            self.ending = code, reason
            self._scope.cancel()

    def send_text(self, message: str, limit: int) -> None:
        """Send a text message now or after the pending ones; closes the connection if ``limit`` are pending."""
        if len(self.pending) >= limit:
            self.end(TOO_SLOW, f"{limit} messages are unread")
            return
        self.pending.append(message)
        self.flush()

    def flush(self) -> bool:
        """Send pending messages; return whether none is left."""
        while self.pending:
            if not self._try({"type": "websocket.send", "text": self.pending[0]}):
                return False
            self.pending.popleft()
        return True

    def send_binary(self, message: bytes) -> bool:
        """Send a binary message now or drop it; return whether it was sent."""
        if self.ending is not None or (self.pending and not self.flush()):
            return False
        if self._transport is None:
            return self._try({"type": "websocket.send", "bytes": message})
        try:
            return self._transport.send_binary(message)
        except ConnectionError:  # its endpoint detects it too
            self.lost = True
            return False

    def _try(self, message: MutableMapping[str, Any]) -> bool:
        if self.ending is not None:
            return False
        try:
            return _run_once(self._send(message))  # type: ignore[arg-type]
        except Exception:  # of one of several kinds; its endpoint detects it too
            self.lost = True
            return False
