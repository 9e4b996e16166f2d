"""A process without threads that forks children, and its loop of sockets, timers and ends of children.

A fork copies the calling thread alone. A lock that another thread holds would stay locked in the child for ever, so the
parent has no threads and no asyncio loop for its whole life, and opens no database. Linux only: elsewhere system
libraries start threads of their own.
"""

from __future__ import annotations

import ctypes
import gc
import heapq
import os
import selectors
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable, Collection
from contextlib import suppress
from itertools import count
from typing import NoReturn

__all__ = ["AVAILABLE", "Child", "Parent", "TooManyThreads"]

AVAILABLE = sys.platform == "linux"

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
"""Numbers of ``prctl``, from ``linux/prctl.h``."""

_STANDARD = (0, 1, 2)

Run = Callable[[], int | None]


class TooManyThreads(RuntimeError):
    """The process has threads and cannot be forked safely."""


class Child:
    """A child process; its id stays valid until its end is collected, which the parent alone does.

    Parameters
    ----------
    pid : int
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.code: int | None = None
        """Exit code, or the negative number of the signal that ended it; None while it runs."""

    def signal(self, number: int) -> None:
        """Send a signal, unless the child has ended."""
        if self.code is None:
            os.kill(self.pid, number)


class Parent:
    """Forks children and runs callbacks, each at a time, in the main thread."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._children: dict[int, tuple[Child, Callable[[int], None]]] = {}
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        reader, writer = socket.socketpair()
        reader.setblocking(False)
        writer.setblocking(False)
        self._wakeup = (reader, writer)
        signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)  # with a handler, the wake-up socket receives it
        self.watch(reader, self._woken)

    def watch(self, sock: socket.socket, readable: Callable[[], None]) -> None:
        """Call back whenever a socket has something to read, or its other end is closed."""
        self._selector.register(sock, selectors.EVENT_READ, readable)

    def forget(self, sock: socket.socket) -> None:
        """Stop watching a socket, and close it."""
        with suppress(KeyError, ValueError):
            self._selector.unregister(sock)
        sock.close()

    def later(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back once, after some seconds."""
        heapq.heappush(self._timers, (time.monotonic() + seconds, next(self._order), callback))

    def fork(
        self,
        run: Run,
        *,
        name: str,
        on_end: Callable[[int], None],
        keep: Collection[int] = (),
        with_parent: signal.Signals = signal.SIGTERM,
    ) -> Child:
        """Fork a child that runs a function and ends with the code that it returns (None is 0).

        The child is in a session of its own, has default signal handlers, and no file descriptors but the standard ones
        and those to keep.

        Parameters
        ----------
        run : callable
        name : str
            Name of the process for ``ps``, at most 15 bytes.
        on_end : callable
            Called by the parent with the child's exit code, or the negative number of the signal that ended it.
        keep : collection of int
            File descriptors that stay open in the child.
        with_parent : int
            Signal that the child receives when the parent ends.

        Raises
        ------
        TooManyThreads
            A library started a thread.
        """
        if len(os.listdir("/proc/self/task")) > 1:
            raise TooManyThreads("this process has threads; forking it could block the child for ever")
        sys.stdout.flush()
        sys.stderr.flush()
        parent = os.getpid()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            pid = os.fork()
        except OSError:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            raise
        if pid == 0:
            _become(run, name=name, keep={*_STANDARD, *keep}, parent=parent, with_parent=with_parent)
        child = Child(pid)
        self._children[pid] = child, on_end
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        return child

    def turn(self) -> None:
        """Wait until something happens, and call back for all that did."""
        timeout = max(0.0, self._timers[0][0] - time.monotonic()) if self._timers else None
        for key, _ in self._selector.select(timeout):
            if self._selector.get_map().get(key.fd) is key:  # an earlier callback may have removed it
                key.data()
        while self._timers and self._timers[0][0] <= time.monotonic():
            heapq.heappop(self._timers)[2]()
        self._collect()

    def close(self) -> None:
        """Stop receiving signals, and close what the loop opened."""
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        self._selector.close()
        for sock in self._wakeup:
            sock.close()

    def _woken(self) -> None:
        with suppress(BlockingIOError):
            while self._wakeup[0].recv(4096):
                pass

    def _collect(self) -> None:
        """Collect the ends of children; as process 1 of a container also those of orphans."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            child, on_end = self._children.pop(pid, (None, None))
            if child is not None and on_end is not None:
                child.code = os.waitstatus_to_exitcode(status)
                on_end(child.code)


def _become(run: Run, *, name: str, keep: set[int], parent: int, with_parent: signal.Signals) -> NoReturn:
    """Be the child: nothing of the parent's loop is used any more, and its frames are never returned to."""
    code: int = 1
    try:
        signal.set_wakeup_fd(-1)
        for number in signal.valid_signals():
            if callable(signal.getsignal(number)):
                signal.signal(number, signal.SIG_DFL)
        _control(_PR_SET_PDEATHSIG, with_parent)
        _control(_PR_SET_NAME, name.encode()[:15])
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
        if os.getppid() == parent:  # else it has ended before its signal was set
            os.setsid()
            for fd in map(int, os.listdir("/proc/self/fd")):
                if fd not in keep:
                    with suppress(OSError):  # the folder's own
                        os.close(fd)
            gc.enable()
            code = run() or 0
    except SystemExit as err:
        code = err.code if isinstance(err.code, int) else int(err.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _control(option: int, value: int | bytes) -> None:
    """Set an attribute of this process; raises OSError."""
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")
