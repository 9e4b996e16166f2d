"""The parent of everything that ``adverb serve`` runs: servers, refiners, and a sandbox for every upload.

It imports modules and loads kernels once and forks all others, which share its memory. It serves nothing itself, has no
threads and opens no database, so that it can fork at any time. It restarts children that die, and on SIGTERM or SIGINT
lets all of them drain.

uvicorn's own supervisor is not used: it starts a plain ``uvicorn.Server``, which does not close streams with a reason,
restarts without a pause, and does not report when all servers are ready.
"""

from __future__ import annotations

import gc
import json
import signal
import socket
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import structlog

from service.run import children, logs, warmup
from service.run.fork import Child, Parent
from service.run.listener import CannotServe, check, greeting, listen
from service.run.loads import Loads
from service.run.progress import Progress
from service.run.restart import Pauses, name_of
from service.run.sandboxes import SandboxForks
from service.settings import Settings
from service.upload.sandbox import MAX_REQUEST_BYTES

__all__ = ["serve"]

DRAIN_S = 5.0
"""How much longer than ``shutdown_s`` a server may take to end before it is killed."""

REFINER_S = 15.0
"""How long a refiner may take to end before it is killed: its own limit, and some seconds."""

log = structlog.get_logger("adverb.supervisor")


def serve(settings: Settings, *, report: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT; running requests may finish, for ``shutdown_s`` at most.

    Parameters
    ----------
    settings : Settings
    report : callable
        Receives the lines of :func:`service.run.listener.greeting` when every server is ready; before that, now and
        then, how long the start has taken.

    Raises
    ------
    CannotServe
        The address or the data folder cannot be used, or the first server ends before it is ready.
    """
    check(settings)
    gc.disable()  # what is loaded stays; collections would copy shared pages
    with ExitStack() as stack:
        listener = stack.enter_context(listen(settings))
        metrics = None
        if settings.workers > 1:
            metrics = Path(stack.enter_context(TemporaryDirectory(prefix="adverb-metrics-")))
        logs.configure(settings)
        progress = Progress(report)
        stack.callback(progress.close)
        supervisor = Supervisor(settings, listener, metrics, report, on_ready=progress.close)
        stack.callback(supervisor.close)
        supervisor.run()


class _Stop(BaseException):
    """A signal to stop came while modules and kernels were loaded."""


@dataclass
class _Slot:
    """One server or refiner that is to run, and is restarted when it dies."""

    name: str
    end_s: float
    """How long it may take to end before it is killed."""
    number: int | None = None
    """Number of a server; None for a refiner."""
    child: Child | None = None
    pauses: Pauses = field(default_factory=Pauses)

    @property
    def kind(self) -> str:
        """Kind of the process, for the log."""
        return "worker" if self.number is None else "server"

    @property
    def label(self) -> dict[str, str | int]:
        """Name of the process, for the log."""
        return {"worker": self.name} if self.number is None else {"process": self.number}


class Supervisor:
    """Starts children, restarts them and ends them.

    Parameters
    ----------
    settings : Settings
    listener : socket
        Bound to the port; the servers listen on it.
    metrics : Path or None
        Empty folder for the metrics of several servers.
    report : callable
    on_ready : callable
        Called before the first line that ``report`` receives.
    """

    def __init__(
        self,
        settings: Settings,
        listener: socket.socket,
        metrics: Path | None,
        report: Callable[[str], None],
        *,
        on_ready: Callable[[], None],
    ) -> None:
        self._settings = settings.model_copy(update={"port": listener.getsockname()[1]})
        self._listener, self._metrics, self._report, self._on_ready = listener, metrics, report, on_ready
        self._parent = Parent()
        self._slots: list[_Slot] = []
        self._sandboxes = SandboxForks(self._parent)
        self._loads = Loads(settings.workers) if settings.workers > 1 else None
        self._unready = set(range(settings.workers))
        self._facts: dict[str, Any] | None = None
        self._failure: str | None = None
        self._stopping = self._loading = self._complete = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._signalled)

    def run(self) -> None:
        """Keep everything running until a signal comes, then end it; raises :class:`CannotServe`."""
        try:
            self._load(warmup.load_serving)
            self._add_server(0)
            while not self._stopping:
                self._parent.turn()
                if not self._unready and not self._complete:
                    self._complete_start()
        except _Stop:
            pass
        self._end_all()
        if self._failure is not None:
            raise CannotServe(self._failure)
        log.info("ended")

    def close(self) -> None:
        """Stop receiving signals."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        self._parent.close()

    def _signalled(self, number: int, frame: FrameType | None) -> None:
        """Stop. The signal also wakes the loop; loading, which does not look, is interrupted."""
        del number, frame
        self._stopping = True
        if self._loading:
            self._loading = False
            raise _Stop

    def _load(self, load: Callable[[], None]) -> None:
        """Import modules and load kernels for the children that are forked from now on."""
        self._loading = True
        try:
            load()
        finally:
            self._loading = False
        if self._stopping:
            raise _Stop
        gc.collect()
        gc.freeze()

    def _complete_start(self) -> None:
        """Load what refiners and sandboxes need, when all servers are ready, and start the refiners."""
        self._complete = True
        if self._settings.data is None:
            return
        self._load(warmup.load_building)
        for number in range(self._settings.refiners):
            self._add(_Slot(name_of(number), REFINER_S))

    def _add_server(self, number: int) -> None:
        self._add(_Slot(f"server {number}", self._settings.shutdown_s + DRAIN_S, number))

    def _add(self, slot: _Slot) -> None:
        self._slots.append(slot)
        self._start(slot)

    def _start(self, slot: _Slot) -> None:
        """Start a child, unless all are to end; try again later where the system has no process or memory left."""
        if self._stopping:
            return
        slot.pauses.started()
        try:
            slot.child = self._fork_refiner(slot) if slot.number is None else self._fork_server(slot, slot.number)
        except OSError as err:
            pause_s = slot.pauses.next_s()
            log.warning("a child cannot be forked; trying again", name=slot.name, problem=str(err), pause_s=pause_s)
            self._parent.later(pause_s, partial(self._start, slot))
            return
        log.info(f"{slot.kind} started", **slot.label, pid=slot.child.pid)

    def _fork_refiner(self, slot: _Slot) -> Child:
        run = partial(children.refine, self._settings, slot.name, self._report)
        return self._parent.fork(run, name="adverb-refiner", on_end=partial(self._ended, slot))

    def _fork_server(self, slot: _Slot, number: int) -> Child:
        mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        run = partial(
            children.serve, self._settings, self._listener, its, number=number, loads=self._loads, metrics=self._metrics
        )
        keep = {its.fileno(), self._listener.fileno()}
        child = self._parent.fork(run, name="adverb-server", keep=keep, on_end=partial(self._ended, slot))
        its.close()
        self._parent.watch(mine, partial(self._received, slot, mine))
        if self._metrics is not None:
            (self._metrics / f"{number}.pid").write_text(str(child.pid), encoding="ascii")
        return child

    def _received(self, slot: _Slot, sock: socket.socket) -> None:
        """Take a server's message: that it is ready, why it cannot serve, or an upload."""
        try:
            data, sent, _, _ = socket.recv_fds(sock, MAX_REQUEST_BYTES, 1)
        except ConnectionError:
            data, sent = b"", []
        if not data:
            self._parent.forget(sock)
            return
        message = json.loads(data)
        if "ready" in message:
            self._ready(slot, message["ready"])
        elif "failed" in message:
            self._fail(message["failed"])
        elif sent:
            self._sandboxes.start(message["job"], socket.socket(fileno=sent[0]))

    def _ready(self, slot: _Slot, facts: dict[str, Any]) -> None:
        """Record that a server is ready, and report it when all are for the first time."""
        if self._facts is None:  # the first one publishes the files of the data folder, alone
            self._facts = facts
            for number in range(1, self._settings.workers):
                self._add_server(number)
        starting = bool(self._unready)
        self._unready.discard(slot.number or 0)
        if starting and not self._unready:
            self._on_ready()
            for line in greeting(self._listener, **self._facts, processes=self._settings.workers):
                self._report(line)

    def _fail(self, problem: str) -> None:
        """End all, where the first server cannot serve; a later one is restarted."""
        if self._facts is None and self._failure is None:
            self._failure, self._stopping = problem, True

    def _ended(self, slot: _Slot, code: int) -> None:
        """Restart a child that died, after a pause."""
        slot.child = None
        if slot.number is not None:
            self._remove_metrics(slot.number)
            if self._loads is not None:
                self._loads.clear(slot.number)
            self._fail_unready(code)
        if self._stopping:
            return
        pause_s = slot.pauses.next_s()
        log.warning(f"{slot.kind} died; starting another", **slot.label, code=code, pause_s=pause_s)
        self._parent.later(pause_s, partial(self._start, slot))

    def _fail_unready(self, code: int) -> None:
        if not self._stopping:
            self._fail(f"a server process ended (code {code}) before it was ready; see above")

    def _remove_metrics(self, number: int) -> None:
        """Remove the gauges of a server that ended; its counters stay."""
        if self._metrics is None:
            return
        from prometheus_client.multiprocess import mark_process_dead

        (self._metrics / f"{number}.pid").unlink(missing_ok=True)
        mark_process_dead(number, str(self._metrics))  # type: ignore[no-untyped-call]

    def _end_all(self) -> None:
        """Let every child end, all at once; kill those that take longer than they may."""
        self._stopping = True
        self._listener.close()  # with the servers' copies closed too, connections are refused from now on
        for slot in self._slots:
            if slot.child is not None:
                slot.child.signal(signal.SIGTERM)
                self._parent.later(slot.end_s, partial(self._kill, slot))
        while any(slot.child is not None for slot in self._slots):
            self._parent.turn()
        self._sandboxes.close()

    @staticmethod
    def _kill(slot: _Slot) -> None:
        if slot.child is not None:
            log.warning("a child does not end; it is killed", name=slot.name, pid=slot.child.pid)
            slot.child.signal(signal.SIGKILL)
