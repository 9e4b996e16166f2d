"""Servers as processes: start one on a core, read its CPU time and memory, stop it."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Served", "StartError", "pinned", "serve"]

START_S = 240.0
"""Longest wait for a server; its kernels may have to be compiled first."""


_CORES = os.sched_getaffinity(0)
"""Cores that are available at the start, before any pinning."""


class StartError(Exception):
    """The server did not start; the message has the end of its log."""


@dataclass(frozen=True, slots=True)
class Served:
    """A running server.

    Parameters
    ----------
    pid : int
    base : str
        Its REST address.
    """

    pid: int
    base: str

    @property
    def url(self) -> str:
        """Address of its stream."""
        return self.base.replace("http", "ws", 1) + "/v1/stream"

    def cpu_s(self) -> float:
        """CPU seconds of all threads of all its processes so far."""
        return self._scheduled(0)

    def waited_s(self) -> float:
        """Seconds so far that its threads waited for a core."""
        return self._scheduled(1)

    def _scheduled(self, column: int) -> float:
        total_ns = 0
        for server in self.servers:
            for file in Path(f"/proc/{server}/task").glob("*/schedstat"):
                try:
                    total_ns += int(file.read_text().split()[column])
                except (FileNotFoundError, ProcessLookupError):
                    continue  # the thread has ended
        return total_ns * 1e-9

    @property
    def server(self) -> int:
        """Id of the first process that serves."""
        return self.servers[0]

    @property
    def servers(self) -> list[int]:
        """Ids of the processes that serve: the servers of a supervisor, or the program itself."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children")
        found = children.read_text().split() if children.exists() else []
        named = [child for child in found if Path(f"/proc/{child}/comm").read_text().strip() == "adverb-server"]
        return [int(child) for child in named] or [self.pid]

    def rss_mib(self) -> float:
        """Resident memory, MiB."""
        lines = Path(f"/proc/{self.server}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024.0

    def threads(self) -> int:
        """Number of threads."""
        return len(os.listdir(f"/proc/{self.server}/task"))

    def files(self) -> int:
        """Number of open files and sockets."""
        return len(os.listdir(f"/proc/{self.server}/fd"))

    def sockets(self) -> int:
        """Number of open sockets; pools open other files when they are first busy, and keep them."""
        found = 0
        for link in Path(f"/proc/{self.server}/fd").iterdir():
            with suppress(FileNotFoundError):  # closed meanwhile
                found += os.readlink(link).startswith("socket:")
        return found


@contextmanager
def pinned(core: int | None) -> Iterator[None]:
    """Run on one core, if it exists, or on all of them if None; child processes inherit it."""
    before = os.sched_getaffinity(0)
    if core is None or core in _CORES:
        os.sched_setaffinity(0, _CORES if core is None else {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def serve(
    command: Sequence[str], *, core: int | None, cwd: Path, environment: Mapping[str, str] | None = None
) -> Iterator[Served]:
    """A server that is stopped at the end of the block.

    Parameters
    ----------
    command : list of str
        Prints a line with its address, ``… ready on http://HOST:PORT …``, on stderr.
    core : int or None
        Core to run on; any if None.
    cwd : Path
    environment : mapping or None
        Added to that of this process.

    Raises
    ------
    StartError
    """
    with pinned(core):
        process = subprocess.Popen(
            list(command),
            cwd=cwd,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    log: list[str] = []
    try:
        yield Served(process.pid, _address(process, log))
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def _address(process: subprocess.Popen[bytes], log: list[str]) -> str:
    """Wait for the line with the address."""
    assert process.stderr is not None
    os.set_blocking(process.stderr.fileno(), False)
    end, rest = time.monotonic() + START_S, b""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stderr, selectors.EVENT_READ)
        while time.monotonic() < end:
            selector.select(timeout=0.5)
            chunk = process.stderr.read()
            if chunk == b"":
                raise StartError(f"the server ended: {' | '.join(log[-5:])}")
            *lines, rest = (rest + (chunk or b"")).split(b"\n")
            log += [line.decode("utf-8", "replace") for line in lines]
            for line in log:
                _, found, after = line.partition("ready on http")
                if found:
                    return "http" + after.split(" ")[0].rstrip()
    raise StartError(f"the server was not ready within {START_S:g} s: {' | '.join(log[-5:])}")
