"""One warm parent for the processes that tests start: it imports and loads everything once, then forks.

The parent is the service's own (`service.run.fork`, `warmup`, `sandboxes`); only what a child runs is chosen by the
test: a command line by default. Tests of the start-up itself use `subprocess` instead.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import IO, Any

from service.run.fork import Parent
from service.run.sandboxes import SandboxForks
from service.settings import Settings
from service.upload.forked import Forked

PROJECT = Path(__file__).parents[1]
COMMAND = "service.cli:main"
LONGEST_START_S = 300.0
"""Kernels may have to be compiled first."""

END_S = 30.0
MAX_REQUEST_BYTES = 100_000


class Warm:
    """The warm parent, seen from a test."""

    def __init__(self) -> None:
        self.control, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with its:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.warm", str(its.fileno())], pass_fds=(its.fileno(),), cwd=PROJECT
            )

    def start(self, *arguments: str, **options: Any) -> Process:
        """Start `adverb` with arguments; see :class:`Process`."""
        return Process(self.control, [*arguments], **options)

    def close(self) -> None:
        """End the parent and everything that was started."""
        self.control.close()
        self._process.wait(END_S)


@cache
def warm() -> Warm:
    """The warm parent of this test process; the session's fixture closes it."""
    return Warm()


class Sandboxes:
    """Sandboxes that the warm parent forks, for servers in a thread of the test."""

    async def prepare(self) -> None:
        warm()

    async def work(self, job):
        return await Forked(warm().control).work(job)

    async def close(self) -> None:
        pass


class Workers:
    """Workers that the warm parent forks for a server in a thread of the test; they are restarted when they end."""

    def __init__(self) -> None:
        self.running: dict[str, Process] = {}

    async def supervise(self, settings: Settings) -> None:
        """Keep them running until cancelled."""
        names = [f"test-{os.getpid()}-{id(self)}-{number}" for number in range(settings.refiners)]
        try:
            while True:
                for name in names:
                    if name not in self.running or self.running[name].poll() is not None:
                        environment = {**os.environ, **settings.environment()}
                        self.running[name] = warm().start("worker", "--name", name, environment=environment)
                await asyncio.sleep(0.05)
        finally:
            for worker in self.running.values():
                worker.terminate()
            for worker in self.running.values():
                worker.wait(END_S)


class Process:
    """A process that the warm parent forks, with the interface of `subprocess.Popen` as far as tests use it.

    Parameters
    ----------
    control : socket
    arguments : list of str
    environment : dict, optional
        Replaces the whole environment; by default that of the test.
    cwd : Path
    stdout, stderr : file, PIPE, DEVNULL or None
    target : str
        Function to call, as `module:name`; without arguments, which are in `sys.argv`.
    """

    def __init__(self, control, arguments, *, environment=None, cwd=PROJECT, stdout=None, stderr=None, target=COMMAND):
        self.returncode: int | None = None
        self._status, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.stdout, out = _opened(stdout, 1)
        self.stderr, err = _opened(stderr, 2)
        request = {
            "target": target,
            "arguments": arguments,
            "environment": dict(os.environ) if environment is None else environment,
            "cwd": str(cwd),
        }
        socket.send_fds(control, [json.dumps(request).encode()], [its.fileno(), out, err])
        for number in (out, err):
            os.close(number)
        its.close()
        self._status.settimeout(LONGEST_START_S)
        self.pid: int = json.loads(self._status.recv(100))["pid"]

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it ends; its exit code."""
        if self.returncode is None:
            self._status.settimeout(timeout)
            try:
                data = self._status.recv(100)
            except (TimeoutError, BlockingIOError):
                raise subprocess.TimeoutExpired("a forked process", timeout or 0.0) from None
            assert data, "the warm parent ended"
            self.returncode = json.loads(data)["code"]
            self._status.close()
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def end(self) -> None:
        """Kill it and all its descendants, and wait until they are gone."""
        below = descendants(self.pid) if self.poll() is None else []
        self.kill()
        for pid in below:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.wait(END_S)
        end = time.monotonic() + END_S
        while any(map(lives, below)):
            assert time.monotonic() < end, below
            time.sleep(0.01)
        for pipe in (self.stdout, self.stderr):
            if pipe is not None:
                pipe.close()


def _opened(target: Any, standard: int) -> tuple[IO[bytes] | None, int]:
    """The test's end of a standard stream, and a file descriptor for the child."""
    if target == subprocess.PIPE:
        reader, writer = os.pipe()
        return os.fdopen(reader, "rb"), writer
    if target == subprocess.DEVNULL:
        return None, os.open(os.devnull, os.O_WRONLY)
    return None, os.dup(standard if target is None else target.fileno())


def status(pid: int) -> list[str]:
    """State, parent and the rest of `/proc/PID/stat`; state X where there is no such process."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    except OSError:
        return ["X", "0"]


def lives(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    return status(pid)[0] not in "XZ"


def name(pid: int) -> str:
    """Name of a process, as `ps` lists it."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/comm").read_text().strip()
    return ""


def children(pid: int, of: str | None = None) -> list[int]:
    """Ids of running children, of all or of those with a name."""
    everyone = [int(path.name) for path in Path("/proc").glob("[0-9]*")]
    found = [one for one in everyone if int(status(one)[1]) == pid and lives(one)]
    return sorted(one for one in found if of in (None, name(one)))


def descendants(pid: int) -> list[int]:
    """Ids of running children and of theirs."""
    found = children(pid)
    return [*found, *(below for child in found for below in descendants(child))]


def main() -> None:
    """Be the warm parent, until the test process closes its socket."""
    from service.run import warmup

    control = socket.socket(fileno=int(sys.argv[1]))
    gc.disable()
    warmup.load_serving()
    warmup.load_building()
    gc.collect()
    gc.freeze()
    parent, running = Parent(), {}
    sandboxes = SandboxForks(parent)

    def take() -> None:
        data, sent, _, _ = socket.recv_fds(control, MAX_REQUEST_BYTES, 3)
        if not data:
            for child in running.values():
                child.signal(signal.SIGKILL)
            os._exit(0)
        request = json.loads(data)
        if "job" in request:
            sandboxes.start(request["job"], socket.socket(fileno=sent[0]))
            return
        fork(request, sent)

    def fork(request: dict[str, Any], sent: list[int]) -> None:
        reply = socket.socket(fileno=sent[0])
        child = parent.fork(
            partial(_run, request, sent[1], sent[2]),
            name="adverb",
            keep=sent[1:],
            on_end=lambda code: ended(child.pid, reply, code),
            with_parent=signal.SIGKILL,
        )
        running[child.pid] = child
        reply.send(json.dumps({"pid": child.pid}).encode())
        for number in sent[1:]:
            os.close(number)

    def ended(pid: int, reply: socket.socket, code: int) -> None:
        del running[pid]
        with suppress(OSError):
            reply.send(json.dumps({"code": code}).encode())
        reply.close()

    parent.watch(control, take)
    while True:
        parent.turn()


def _run(request: dict[str, Any], out: int, err: int) -> None:
    """Be what a test asks for, with its streams, environment and folder."""
    null = os.open(os.devnull, os.O_RDONLY)
    for source, number in ((null, 0), (out, 1), (err, 2)):
        os.dup2(source, number)
        os.close(source)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    tempfile.tempdir = None  # it may depend on the environment
    sys.argv = ["adverb", *request["arguments"]]
    module, _, function = request["target"].partition(":")
    getattr(import_module(module), function)()


if __name__ == "__main__":
    main()
