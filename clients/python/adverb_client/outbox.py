"""Queue of outgoing messages, thread-safe; a newer message replaces an unsent one with the same key."""

from __future__ import annotations

import asyncio
import itertools
import json
import threading
from collections.abc import Mapping
from typing import Any

__all__ = ["Outbox"]


class Outbox:
    """Outgoing messages in the order of their last change.

    A message replaces an unsent one with the same key; the fields of two ``set`` messages are merged. So the queue
    holds at most two messages per channel, one per set of channels that are steered together, and the requests that
    have an answer.

    Parameters
    ----------
    loop : asyncio.AbstractEventLoop
        The loop in which messages are taken.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop, self._thread = loop, threading.get_ident()
        self._filled = asyncio.Event()
        self._numbers = itertools.count()
        self._messages: dict[tuple[str, int | bytes], Mapping[str, Any] | bytes] = {}
        self._lock = threading.Lock()

    def put(self, key: tuple[str, int | bytes] | None, message: Mapping[str, Any] | bytes) -> None:
        """Add a message; with key None it replaces no other."""
        key = key or ("", next(self._numbers))
        with self._lock:
            old = self._messages.pop(key, None)
            self._messages[key] = _merged(old, message)
        if threading.get_ident() == self._thread:
            self._filled.set()
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._filled.set)

    def clear(self) -> None:
        """Discard all unsent messages."""
        with self._lock:
            self._messages.clear()

    async def take(self) -> list[str | bytes]:
        """Wait for messages and take all of them, encoded as text or binary messages."""
        await self._filled.wait()
        self._filled.clear()
        with self._lock:
            messages = list(self._messages.values())
            self._messages.clear()
        return [message if isinstance(message, bytes) else json.dumps(message) for message in messages]


def _merged(old: Mapping[str, Any] | bytes | None, new: Mapping[str, Any] | bytes) -> Mapping[str, Any] | bytes:
    if not isinstance(old, Mapping) or not isinstance(new, Mapping) or new.get("op") != "set":
        return new
    merged = {**old, **new}
    if "adverbs" in old and "adverbs" in new:
        merged["adverbs"] = {**old["adverbs"], **new["adverbs"]}
    return merged
