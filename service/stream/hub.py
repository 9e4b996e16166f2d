"""All streams of one server process: sessions, and groups of characters.

Clients' messages come from the event loop as commands, and everything but :meth:`Hub.post`, :meth:`Hub.run`,
:meth:`Hub.drain` and :meth:`Hub.set_catalog` runs in the engine's thread.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import structlog

from service import errors
from service.catalog.catalog import Catalog
from service.errors import ServiceError, UnknownSession
from service.metrics import Metrics
from service.refinement.usage import Usage
from service.settings import Settings
from service.stream.channel import opened
from service.stream.channels import Channels
from service.stream.connection import Connection, DirectConnection
from service.stream.engine import Engine
from service.stream.interest import Interest
from service.stream.kernels import U16
from service.stream.messages import Close, Open, Ping, Resume, Set, Switch, View
from service.stream.sampling import CharacterSampler
from service.stream.session import LineTable, Session
from service.stream.ticks import Prepared, Ticks
from verbs.conventions import F32
from verbs.errors import VerbError

__all__ = ["Hub"]

SWEEP_S = 0.5

WAITING_S = 0.002
"""Interval at which a connection is tried again whose client has not read what was sent, seconds."""

IDLE_S = 0.05
"""Longest time for which a command waits that does not wake the engine, seconds."""

END_S = 1.0
"""Time for the last commands when the engine ends, seconds."""

log = structlog.get_logger("adverb.stream")


class Hub:
    """Sessions and their characters.

    Parameters
    ----------
    settings : Settings
    metrics : Metrics
    catalog : callable
        Gives the verbs that are served now; raises :class:`service.errors.NotReady`.
    usage : Usage
        Records twice a second what every character is requested for.

    Attributes
    ----------
    connections : int
        Number of connections; the event loop counts them.
    """

    def __init__(self, settings: Settings, metrics: Metrics, catalog: Callable[[], Catalog], usage: Usage) -> None:
        self.settings, self.metrics = settings, metrics
        self._sampler = CharacterSampler(usage)
        self.sessions: dict[str, Session] = {}
        self.connections, self.draining = 0, False
        self.engine = Engine(self)
        self.post = self.engine.post
        self._loop: asyncio.AbstractEventLoop | None = None
        self._table = LineTable()
        self._waiting: set[Session] = set()
        self._closing: set[Connection] = set()
        self._session_of: dict[Connection, Session] = {}
        self._connections: set[Connection] = set()
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._sweep_at_s = time.monotonic() + SWEEP_S
        self.ticks = Ticks(time.monotonic(), self._table, metrics)
        self.channels = Channels(settings, catalog, self.ticks, self._send)

    # ── called by the event loop ─────────────────────────────────────────────────────────────────────────────────

    def server_time_ns(self) -> int:
        """The server's clock: ns since 1970, set at the start and monotonic since."""
        return self._epoch_ns + time.monotonic_ns()

    async def run(self) -> None:
        """Run the engine until cancelled."""
        self._loop = asyncio.get_running_loop()
        try:
            await self.engine.run()
        finally:
            self.engine.handle(END_S)
            for connection in self._connections:
                connection.cut()
            self.channels.receivers.close()

    @property
    def full(self) -> bool:
        """Whether the server has its maximum number of streams."""
        return self.connections >= self.settings.streams

    @property
    def characters(self) -> int:
        """Characters of all sessions."""
        return self.ticks.characters

    def drain(self) -> None:
        """Send ``drain`` to every client and close the connections."""
        self.draining = True
        self.post(self._drain)

    def set_catalog(self, catalog: Catalog) -> None:
        """Continue characters, from the next ticks on, with the versions of a new catalog."""
        self.post(self._continue_with, catalog)

    # ── the engine's work ────────────────────────────────────────────────────────────────────────────────────────

    def start_s(self) -> float | None:
        """When the preparation of the next tick has to start."""
        due_s = self.ticks.due_s()
        return None if due_s is None else due_s - self.ticks.lead_s(due_s)

    def prepare(self) -> Prepared:
        """Prepare the next tick."""
        due_s = self.ticks.due_s()
        assert due_s is not None  # :meth:`start_s` has found one
        return self.ticks.prepare(due_s, max(time.monotonic(), due_s), self.sessions)

    def send(self, prepared: Prepared) -> None:
        """Send a prepared tick."""
        self._waiting.update(self.ticks.send(prepared, self._epoch_ns))

    def idle(self, now_s: float) -> float:
        """Send what waits, continue with new versions, and sweep twice a second; return when to do so again, s."""
        if self._waiting:
            self._flush()
        if self._closing:
            self._closing = {connection for connection in self._closing if not connection.flush()}
        if self.channels.renewing:
            self.channels.renew_some()
        if now_s >= self._sweep_at_s:
            self._sweep_at_s = now_s + SWEEP_S
            self._sweep(now_s)
        if self.channels.renewing:
            return 0.0
        return WAITING_S if self._waiting or self._closing else IDLE_S

    def _continue_with(self, catalog: Catalog) -> None:
        self.channels.renew_all(catalog, self.sessions.values())

    def _flush(self) -> None:
        for session in list(self._waiting):
            if session.connection is None or session.connection.flush():
                self._waiting.discard(session)
            session.refresh()

    # ── sessions ─────────────────────────────────────────────────────────────────────────────────────────────────

    def join(self, connection: Connection, caller: str = "", request_id: str = "") -> None:
        """Start a session for a connection, and greet it; ``caller`` is the id of its key, ids are for the log."""
        session = Session(self._table, slow_s=self.settings.stream_slow_s, caller=caller)
        session.attach(connection)
        self._session_of[connection] = session
        self._connections.add(connection)
        self.sessions[session.id] = session
        log.debug("stream opened", stream=session.public_id, request_id=request_id, key=caller)
        self._send(
            session,
            {
                "op": "hello",
                "session": session.id,
                "server_time_ns": self.server_time_ns(),
                "max_channels": self.settings.stream_channels,
                "grace_s": self.settings.stream_grace_s,
            },
        )

    def leave(self, connection: Connection, for_good: bool) -> None:
        """Handle the end of a connection: keep its session for the grace time, or close it."""
        session = self._session_of.pop(connection, None)
        if not isinstance(connection, DirectConnection):
            connection.cut()  # the event loop closes it; a direct one is closed when its transport is
        if session is None:
            return  # another connection resumed the session
        session.detach(time.monotonic())
        log.debug("stream left", stream=session.public_id, for_good=for_good)
        self.ticks.reconnected()
        if for_good or not session.channels or self.draining:
            self._forget(session)

    def write(self, connection: DirectConnection, data: bytes) -> None:
        """Send frames that the WebSocket library has made."""
        connection.write(data)
        self._note_waiting(connection)

    def close_connection(self, connection: DirectConnection) -> None:
        """Close the socket of a connection once everything is sent."""
        connection.close()
        self._note_waiting(connection)

    def _note_waiting(self, connection: DirectConnection) -> None:
        session = self._session_of.get(connection)
        if connection.pending:
            if session is None:
                self._closing.add(connection)
            else:
                self._waiting.add(session)
        if session is not None:
            session.refresh()

    def _send(self, session: Session, message: dict[str, Any]) -> None:
        session.send_text(message)
        if session.connection is not None and session.connection.pending:
            self._waiting.add(session)

    def _forget(self, session: Session) -> None:
        """End a session and its characters."""
        if self.sessions.pop(session.id, None) is not None:
            for number in list(session.channels):
                self.channels.close(session, number)
            self._waiting.discard(session)
            session.end()
            self.ticks.reconnected()

    def _drain(self) -> None:
        for session in list(self.sessions.values()):
            self._send(session, {"op": "drain", "detail": "the server is stopping", "reconnect_after_s": 1.0})
            if session.connection is not None:
                session.connection.end(1012, "the server is stopping")
                session.refresh()

    def _sweep(self, now_s: float) -> None:
        """Close sessions whose grace time has passed, and report figures."""
        over = now_s - self.settings.stream_grace_s
        for session in [one for one in self.sessions.values() if one.lost_at is not None and one.lost_at < over]:
            self._forget(session)
        self._connections = {connection for connection in self._connections if not connection.lost}
        self.metrics.set_streams(sum(one.connected for one in self.sessions.values()), self.characters)
        for session in self.sessions.values():
            message = session.interest.stats(now_s) if session.interest is not None else None
            if message is not None:
                self._send(session, message)
        samples = self._sampler.take(self.channels.groups.values())
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._sampler.record, samples)

    # ── messages of clients ──────────────────────────────────────────────────────────────────────────────────────

    def handle(self, connection: Connection, channel: int | None, message: Any) -> None:
        """Handle a message, or the error of an invalid one; ``channel`` is the one that it names, if any."""
        session = self._session_of.get(connection)
        connection.handled += 1
        if session is None:
            return
        try:
            if isinstance(message, Exception):
                raise message
            self._apply(session, connection, message)
        except (ServiceError, VerbError) as err:
            self._report(self._session_of.get(connection, session), channel, err)
        except Exception:
            log.exception("stream message failed", stream=session.public_id)
            detail = "internal error; the server's log has the details"
            self._send(session, {"op": "error", "channel": channel, "code": "internal_error", "detail": detail})

    def aim(self, connection: Connection, channels: U16, values: F32, whole: bool) -> None:
        """Set the goals of characters; see :meth:`service.stream.session.Session.aim`."""
        session = self._session_of.get(connection)
        connection.handled += 1
        if session is not None:
            session.aim(channels, values, whole=whole, report=lambda channel, err: self._report(session, channel, err))

    def _report(self, session: Session, channel: int | None, err: ServiceError | VerbError) -> None:
        code, detail = errors.code_of(err)
        self._send(session, {"op": "error", "channel": channel, "code": code, "detail": detail})

    def _apply(self, session: Session, connection: Connection, message: Any) -> None:
        match message:
            case Open():
                self.channels.open(session, message)
            case Set():
                self.channels.set(session, message)
            case Switch():
                self.channels.switch(session, message)
            case Close():
                session.channel(message.channel)
                self.channels.close(session, message.channel)
            case View():
                self._view(session, message)
            case Ping():
                self._send(session, {"op": "pong", "t": message.t, "server_time_ns": self.server_time_ns()})
            case Resume():
                self._resume(session, connection, message)

    def _resume(self, session: Session, connection: Connection, message: Resume) -> None:
        """Attach a connection to another session; raises :class:`UnknownSession`."""
        found = self.sessions.get(message.session)
        if found is None or found is session:
            raise UnknownSession("this server has no such session; open the channels again")
        self._forget(session)
        if found.connection is not None:
            del self._session_of[found.connection]
        self._session_of[connection] = found
        found.count_dropped(max(0, found.sequence - message.last_seq))
        found.attach(connection)
        self.ticks.reconnected()
        log.debug("stream resumed", stream=found.public_id, by=session.public_id)
        for channel in found.channels.values():
            self._send(found, opened(channel, resumed=True))

    def _view(self, session: Session, message: View) -> None:
        """Set viewpoint and budget."""
        was = session.interest
        if message.budget_kbps is None:
            session.interest = None
        else:
            point = None if message.x is None else np.array([message.x, message.y, message.z], np.float64)
            session.interest = Interest(message.budget_kbps, point)
            session.interest.follow(was)
        if (was is None) != (session.interest is None):
            self.ticks.reconnected()
