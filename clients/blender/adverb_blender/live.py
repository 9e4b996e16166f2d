"""Poses of goals that change, requested by a thread: only the newest goal counts."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from .rest import Server, ServerError

__all__ = ["RETRY_S", "Goal", "LivePoses"]

RETRY_S = 1.0
"""Pause before a goal is requested again whose request failed; another goal ends it."""


@dataclass(frozen=True)
class Goal:
    """What is requested: a verb, its adverbs in their units, and a phase of 0 to 1."""

    verb: str
    adverbs: tuple[tuple[str, float], ...]
    phase: float


class LivePoses:
    """Requests poses in a thread of its own; the data of Blender is touched by the caller alone.

    Parameters
    ----------
    server : Server
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._changed = threading.Condition()
        self._goal: Goal | None = None
        self._pose: dict[str, Any] | None = None
        self._error: ServerError | None = None
        self._stopping = False
        self._done: Goal | None = None
        self._thread = threading.Thread(target=self._run, name="adverb-poses", daemon=True)
        self._thread.start()

    def aim(self, goal: Goal) -> None:
        """Set the goal; one that equals the last requested one has no effect, unless its request failed."""
        with self._changed:
            self._goal = goal
            self._changed.notify()

    def take(self) -> dict[str, Any] | None:
        """The newest pose since the last call; None if there is none."""
        with self._changed:
            pose, self._pose = self._pose, None
            return pose

    @property
    def error(self) -> ServerError | None:
        """Why the last request failed; None if it did not."""
        with self._changed:
            return self._error

    def stop(self) -> None:
        """End the thread after its request."""
        with self._changed:
            self._stopping = True
            self._changed.notify()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._goal != self._done)
                if self._stopping:
                    return
                done = self._done = self._goal
            assert done is not None
            pose, error = None, None
            try:
                pose = self._server.pose(done.verb, dict(done.adverbs), done.phase)
            except ServerError as err:
                error = err
            with self._changed:
                self._pose, self._error = pose or self._pose, error
                if error is not None:
                    self._changed.wait_for(lambda: self._stopping or self._goal != self._done, RETRY_S)
                    self._done = None
