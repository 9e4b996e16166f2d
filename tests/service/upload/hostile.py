"""A parent and a server process for tests of sandboxes: jobs that misuse a resource, and small limits."""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

import structlog

from service.errors import BadUpload
from service.run.fork import Parent
from service.run.sandboxes import SandboxForks
from service.upload import builder, sandbox
from service.upload.builder import Builder
from service.upload.forked import Forked

MEMORY_BYTES = 64 * 1024**2
FILE_BYTES = 1024**2


def memory(upload: Path, result: Path) -> dict[str, Any]:
    """Allocate half of what is allowed, report it, then twice as much."""
    held = bytearray(MEMORY_BYTES // 2)
    result.write_text(str(len(held)))
    return {"error": str(len(bytearray(2 * MEMORY_BYTES)))}


def cpu(upload: Path, result: Path) -> dict[str, Any]:
    while True:
        pass


def hang(upload: Path, result: Path) -> dict[str, Any]:
    result.write_text(str(os.getpid()))
    time.sleep(600)
    return {"error": "it woke"}


def crash(upload: Path, result: Path) -> dict[str, Any]:
    ctypes.string_at(0)
    return {"error": "it read address 0"}


def file(upload: Path, result: Path) -> dict[str, Any]:
    result.write_bytes(bytes(FILE_BYTES // 2))
    result.write_bytes(bytes(2 * FILE_BYTES))
    return {"error": "it was written"}


def noise(upload: Path, result: Path) -> dict[str, Any]:
    """Write to every standard stream."""
    for number in (1, 2):
        os.write(number, b"from the sandbox")
    return {"error": f"read {os.read(0, 10)!r}"}


def files(upload: Path, result: Path) -> dict[str, Any]:
    """Report open files, signal handlers, limits and threads."""
    links = {}
    for path in Path("/proc/self/fd").iterdir():
        if path.exists():
            links[path.name] = os.readlink(path)
    return {"error": json.dumps({"files": links, "session": os.getsid(0) == os.getpid()})}


def lineage(upload: Path, result: Path) -> dict[str, Any]:
    """Report the process, its parent, and whether it is a fork of it: the command line is the same then."""
    own, other = (Path(f"/proc/{pid}/cmdline").read_bytes() for pid in (os.getpid(), os.getppid()))
    return {"error": json.dumps({"pid": os.getpid(), "parent": os.getppid(), "forked": own == other})}


def long(upload: Path, result: Path) -> dict[str, Any]:
    """Answer with a line that is longer than the server reads."""
    return {"error": "x" * (2 * builder.MAX_ANSWER_BYTES)}


JOBS = {one.__name__: one for one in (memory, cpu, hang, crash, file, noise, files, lineage, long)}
_real = sandbox.work


def work(upload: Path, result: Path) -> dict[str, Any]:
    """Do the job that the file names."""
    job = JOBS.get(upload.read_text())
    try:
        return job(upload, result) if job else _real(upload, result)
    except MemoryError:
        return {"error": "MemoryError"}
    except OSError as err:
        return {"error": f"OSError {err.errno}"}


def main() -> None:
    """Run a parent, whose one child makes the uploads that the command line lists, in order; print their errors."""
    sandbox.work = work
    sandbox.MAX_MEMORY_BYTES, sandbox.MAX_FILE_BYTES, sandbox.MAX_CPU_S = MEMORY_BYTES, FILE_BYTES, 1
    builder.LONGEST_S = float(os.environ.get("LONGEST_S", "60"))
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    parent, codes = Parent(), []
    sandboxes = SandboxForks(parent)
    mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def take() -> None:
        data, sent, _, _ = socket.recv_fds(mine, sandbox.MAX_REQUEST_BYTES, 1)
        if data:
            sandboxes.start(json.loads(data)["job"], socket.socket(fileno=sent[0]))
        else:
            parent.forget(mine)

    parent.watch(mine, take)
    parent.fork(lambda: asyncio.run(uploads(its)), name="adverb-server", keep={its.fileno()}, on_end=codes.append)
    its.close()
    while not codes:
        parent.turn()
    sys.exit(int(codes[0] not in (0, -signal.SIGKILL)))


async def uploads(parent: socket.socket) -> None:
    """Make all uploads, and print a line for each."""
    makes = Builder(Forked(parent))
    for upload in map(Path, sys.argv[1:]):
        try:
            await makes.make(upload, upload.with_suffix(".verb"))
        except BadUpload as err:
            sys.stdout.write(f"{upload.read_text()}\t{err.detail}\n")
            sys.stdout.flush()
