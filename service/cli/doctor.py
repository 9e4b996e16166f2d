"""Command ``doctor``: whether a server can run here, and what to do where it cannot."""

from __future__ import annotations

import json
import os
import platform
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import DEFAULT_DATA, USER_ERROR, settings_of
from service.run.listener import folder_problem
from verbs.cli.output import out, plain

if TYPE_CHECKING:
    from service.settings import Settings
    from service.store.store import Store

__all__ = ["Finding", "doctor_command", "findings"]

GOOD, WARNING, FAILED = "ok", "warning", "failed"

PACKAGES = ("numpy", "numba", "scipy", "fastapi", "uvicorn", "pydantic", "sqlalchemy", "dbos")
LOW_DISK_BYTES = 1e9
CLOCK_S = 5.0
SOON_S = 7 * 86_400.0
OLDEST_S = 1_700_000_000.0
"""A clock before this (November 2023) is wrong."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One check: its name, its state (``ok``, ``warning``, ``failed``), what was found, and what to do."""

    check: str
    state: str
    found: str
    advice: str = ""


def doctor_command(
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the server. [default: data]")] = None,
    host: Annotated[str | None, typer.Option(help="Address of the server. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port of the server. [default: 8000]")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check versions, kernels, folders, database, artifacts, time, port and keys, and say what to do.

    Nothing is changed. Exit code 1 if a check failed.

    Example: [bold]adverb doctor --data data[/]
    """
    settings = settings_of(data=data, host=host, port=port)
    if settings.data is None:
        settings = settings.model_copy(update={"data": DEFAULT_DATA})
    rows = list(findings(settings))
    if as_json:
        typer.echo(json.dumps([asdict(row) for row in rows], indent=2))
    else:
        from rich.table import Table

        table = Table(show_lines=False)
        for column in ("check", "state", "found", "what to do"):
            table.add_column(column, overflow="fold")
        colours = {GOOD: "green", WARNING: "yellow", FAILED: "bold red"}
        for row in rows:
            state = f"[{colours[row.state]}]{row.state}[/]"
            table.add_row(row.check, state, plain(row.found), plain(row.advice))
        out.print(table)
    if any(row.state == FAILED for row in rows):
        raise typer.Exit(USER_ERROR)


def findings(settings: Settings) -> Iterator[Finding]:
    """All checks of a server's settings, which have a data folder, in order."""
    for check in (_versions, _kernels, _page, _memory, _files, _folder, _disk, _port, _exposure):
        yield from _guarded(check, settings)
    yield from _stored(settings)


def _guarded(check: Callable[[Settings], Iterator[Finding]], settings: Settings) -> Iterator[Finding]:
    try:
        yield from check(settings)
    except OSError as err:
        yield Finding(check.__name__.strip("_"), FAILED, str(err), "see the message")


def _versions(settings: Settings) -> Iterator[Finding]:
    del settings
    python = platform.python_version()
    fits = sys.version_info >= (3, 11)
    yield Finding("Python", GOOD if fits else FAILED, python, "" if fits else "install Python 3.11 or newer")
    try:
        found = ", ".join(f"{name} {metadata.version(name)}" for name in PACKAGES)
        yield Finding("packages", GOOD, f"adverb {metadata.version('adverb')}, {found}")
    except metadata.PackageNotFoundError as err:
        yield Finding("packages", FAILED, f"{err.name} is not installed", "install Adverb with its dependencies")


def _kernels(settings: Settings) -> Iterator[Finding]:
    """Compiled kernels are kept in a folder; without one every start compiles for a minute."""
    del settings
    given = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(given) if given else None
    if folder is not None and not _writable(folder):
        advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
        yield Finding("kernels", WARNING, f"{folder} cannot be written to: every start compiles", advice)
        return
    folders = [folder] if folder else [Path(__file__).parents[2] / "verbs", Path(__file__).parents[2] / "service"]
    count = sum(1 for one in folders for _ in one.rglob("*.nbi"))
    if count:
        yield Finding("kernels", GOOD, f"{count} compiled functions are kept in {folders[0]}")
    else:
        advice = "run python -m service.run.warmup, or let the first start take a minute or two"
        yield Finding("kernels", WARNING, "none are compiled yet", advice)


def _page(settings: Settings) -> Iterator[Finding]:
    del settings
    page = Path(__file__).parents[1] / "static" / "index.html"
    if page.is_file():
        yield Finding("page", GOOD, "the dashboard is built")
    else:
        yield Finding("page", WARNING, "the dashboard is not built; / lists the verbs", "run make dashboard")


def _memory(settings: Settings) -> Iterator[Finding]:
    needed = (350 + 40 * (settings.workers + settings.refiners)) * 1e6
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return  # another system than Linux
    free = next((1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), 0.0)
    found = f"{free / 1e9:.1f} GB are free; a start takes about {needed / 1e9:.1f} GB"
    few = free < needed
    yield Finding(
        "memory", WARNING if few else GOOD, found, "free some memory, or start fewer processes" if few else ""
    )


def _files(settings: Settings) -> Iterator[Finding]:
    """Each stream has two open files."""
    if sys.platform == "win32":
        return
    import resource

    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    needed = 2 * settings.streams + 1_024
    if hard == resource.RLIM_INFINITY or hard >= needed:
        yield Finding("open files", GOOD, f"{needed} for {settings.streams} streams are allowed")
    else:
        advice = f"raise the hard limit (ulimit -Hn {needed}), or lower ADVERB_STREAMS"
        yield Finding(
            "open files", WARNING, f"{hard} are allowed, {needed} needed for {settings.streams} streams", advice
        )


def _folder(settings: Settings) -> Iterator[Finding]:
    folder = settings.data
    assert folder is not None
    problem = folder_problem(folder)
    if problem is not None:
        advice = "adverb serve creates data by itself; create any other folder, or name it with --data"
        yield Finding("data folder", WARNING if folder == DEFAULT_DATA else FAILED, problem, advice)
    elif _writable(folder):
        yield Finding("data folder", GOOD, f"{folder.resolve()} can be written to")
    else:
        advice = "give the user of the server write access, or name another folder"
        yield Finding("data folder", FAILED, f"{folder.resolve()} cannot be written to", advice)


def _disk(settings: Settings) -> Iterator[Finding]:
    folder = settings.data
    assert folder is not None
    if folder.is_dir():
        free = shutil.disk_usage(folder).free
        low = free < LOW_DISK_BYTES
        advice = "free some space: publishing and drafts need it" if low else ""
        yield Finding("disk", WARNING if low else GOOD, f"{free / 1e9:.1f} GB are free", advice)


def _port(settings: Settings) -> Iterator[Finding]:
    try:
        family, _, _, _, address = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)[0]
    except OSError as err:
        yield Finding("address", FAILED, f"the host {settings.host} is not known: {err}", "correct --host")
        return
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as err:
            live = _answers(settings)
            if live:
                yield Finding("address", GOOD, f"a server of Adverb answers on {settings.host}:{settings.port}")
                return
            advice = "stop what uses it, or choose another port (--port)"
            yield Finding("address", FAILED, f"port {settings.port} cannot be used: {err.strerror or err}", advice)
            return
    yield Finding("address", GOOD, f"{settings.host}:{settings.port} is free")


def _answers(settings: Settings) -> bool:
    """Whether a server of Adverb answers on the port."""
    from http.client import HTTPConnection, HTTPException

    host = "127.0.0.1" if settings.host in ("0.0.0.0", "::") else settings.host
    connection = HTTPConnection(host, settings.port, timeout=2.0)
    try:
        connection.request("GET", "/livez")
        return connection.getresponse().read(100) == b'{"live":true}'
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()


def _exposure(settings: Settings) -> Iterator[Finding]:
    if not settings.public:
        yield Finding("exposure", GOOD, "only this machine can reach the server")
    elif settings.allow_public or settings.keys == "off":
        advice = "make a key (adverb keys create), and unset ADVERB_ALLOW_PUBLIC"
        yield Finding("exposure", WARNING, "other machines can use the server, perhaps without a key", advice)
    elif not _has_keys(settings):
        found = f"no key is valid, so a server on {settings.host} does not start"
        yield Finding("exposure", FAILED, found, "make a key: adverb keys create --scope pose")
    else:
        yield Finding("exposure", GOOD, "other machines can reach the server, with a key")


def _has_keys(settings: Settings) -> bool:
    """Whether a server on a public address starts: it needs a key that is valid, tokens, or keys from the start.

    A database that cannot be used counts as one with keys, as at the start; other checks report it.
    """
    from service.store.keys import Keys
    from service.store.migrations import LAYOUT
    from service.store.records import StoreError
    from service.store.tables import Database

    if settings.keys == "required" or settings.jwt_jwks is not None:
        return True
    try:
        database = Database(settings.database, timeout_s=5.0)
        try:
            if database.missing:
                return False
            now_s = time.time()
            return database.layout() != LAYOUT or any(key.valid_at(now_s) for key in Keys(database).listed())
        finally:
            database.close()
    except StoreError:
        return True


def _stored(settings: Settings) -> Iterator[Finding]:
    """Database, artifacts, clock and keys; what does not exist yet is not created."""
    from service.store.migrations import LAYOUT
    from service.store.records import StoreError
    from service.store.tables import Database

    started_s = time.monotonic()
    try:
        database = Database(settings.database, timeout_s=5.0)
        try:
            layout = None if database.missing else database.layout()
        finally:
            database.close()
    except StoreError as err:
        advice = "start it, correct ADVERB_DATABASE_URL, or give access to the file"
        yield Finding("database", FAILED, f"it cannot be used: {err}", advice)
        yield from _clock(None)
        return
    took_ms = 1e3 * (time.monotonic() - started_s)
    if database.missing:
        yield Finding("database", GOOD, "there is none yet; the first start creates it")
    elif layout != LAYOUT:
        older = layout is None or layout < LAYOUT
        found = "there are no tables yet" if layout is None else f"its tables have layout {layout}, not {LAYOUT}"
        advice = "the next start changes that; back up before" if older else "use the newer Adverb that made it"
        yield Finding("database", WARNING if older else FAILED, found, advice)
    else:
        kind = "SQLite" if settings.database_url is None else settings.database.partition(":")[0]
        yield Finding("database", GOOD, f"{kind} answers within {took_ms:.0f} ms")
        yield from _rows(settings)
        return
    yield from _clock(None)


def _rows(settings: Settings) -> Iterator[Finding]:
    """Artifacts, clock and keys of a store that exists."""
    from service.store.records import StoreError
    from service.store.store import Store

    with tempfile.TemporaryDirectory() as cache:
        try:
            store = Store.existing(settings.database, settings.artifacts, cache=Path(cache))
        except StoreError as err:
            yield Finding("artifacts", FAILED, str(err), "correct ADVERB_ARTIFACTS")
            return
        try:
            yield from _artifacts(store)
            yield from _clock(store)
            yield from _keys(store)
        except StoreError as err:
            yield Finding("database", FAILED, str(err), "see the message")
        finally:
            store.close()


def _artifacts(store: Store) -> Iterator[Finding]:
    """Every served version is read and compared with its hash."""
    from service.store.records import StoreError

    current, bad = store.current(), []
    for name, version in current.items():
        try:
            store.path(version)
        except StoreError as err:
            bad.append(f"{name} version {version.number}: {err}")
    if bad:
        advice = "activate an older version, upload the verb again, or restore a backup"
        yield Finding("artifacts", FAILED, "; ".join(bad[:5]), advice)
    else:
        yield Finding("artifacts", GOOD, f"{len(current)} verbs are complete")


def _clock(store: Store | None) -> Iterator[Finding]:
    now_s = time.time()
    if now_s < OLDEST_S:
        yield Finding(
            "time", FAILED, f"the clock shows {time.strftime('%Y-%m-%d', time.gmtime(now_s))}", "set the clock"
        )
        return
    ahead_s = 0.0
    if store is not None:
        newest = max((event.at_s for _, event in store.events(limit=1)), default=now_s)
        ahead_s = newest - now_s
    if ahead_s > CLOCK_S:
        advice = "compare the clocks of all machines; keys and limits depend on them"
        yield Finding("time", WARNING, f"the last change lies {ahead_s:.0f} s in the future", advice)
    else:
        yield Finding("time", GOOD, time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now_s)))


def _keys(store: Store) -> Iterator[Finding]:
    now_s = time.time()
    rows = store.keys.listed()
    valid = [key for key in rows if key.valid_at(now_s)]
    soon = [key.id for key in valid if key.expires_at_s is not None and key.expires_at_s - now_s < SOON_S]
    if rows and not valid:
        yield Finding("keys", WARNING, "all keys are revoked or expired", "make one: adverb keys create --scope pose")
    elif soon:
        found = f"{len(valid)} valid; within a week expire {', '.join(soon[:5])}"
        yield Finding("keys", WARNING, found, "make new ones: adverb keys create")
    else:
        yield Finding("keys", GOOD, f"{len(valid)} valid" if rows else "none: requests need no key on loopback")


def _writable(folder: Path) -> bool:
    """Whether files can be made in a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
