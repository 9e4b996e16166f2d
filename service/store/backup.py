"""Backup of a data folder while servers use it, and its restoration: one tar file.

The database is copied by SQLite's own backup, which sees one moment of it, and the artifacts after it. Artifacts never
change, so a copied database finds each of its artifacts. Where one was collected meanwhile, the copy starts again.
A restored folder is checked as a whole before it has its name.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import secrets
import shutil
import sqlite3
import tarfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from service.store.migrations import LAYOUT
from service.store.records import StoreError

__all__ = ["BackupError", "Summary", "backup", "restore"]

MANIFEST = "adverb-backup.json"
FORMAT = 1
ATTEMPTS = 3
CHUNK_BYTES = 1024 * 1024
MAX_MANIFEST = 1024 * 1024
DATABASES = ("state.db", "jobs.db")
"""The store, and the queue of refinements, which may be missing."""

BLOBS = "artifacts"
_BLOB = re.compile(r"artifacts/([0-9a-f]{64})\.verb")
_VERB = re.compile(r"[^/\\\x00.][^/\\\x00]{0,199}\.verb")
_COLUMNS = (
    ("adverb_versions", "sha256"),
    ("adverb_versions", "source_sha256"),
    ("adverb_drafts", "archive"),
    ("adverb_drafts", "motion"),
    ("adverb_drafts", "artifact"),
)
"""Columns that name artifacts."""

Report = Callable[[int, int], None]
"""Called with the files done and the files there are."""


class BackupError(StoreError):
    """A backup cannot be made or restored; the message has the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Content of a backup.

    Parameters
    ----------
    versions, artifacts : int
    size_bytes : int
    created_at_s : float
        Seconds since 1970, UTC.
    """

    versions: int
    artifacts: int
    size_bytes: int
    created_at_s: float


def backup(data: Path, target: Path, *, report: Report = lambda done, total: None) -> Summary:
    """Write a backup of a data folder; servers may use it meanwhile.

    Parameters
    ----------
    data : Path
    target : Path
        A new file; it appears when it is complete.
    report : callable

    Raises
    ------
    BackupError
        The folder has no database, an artifact is missing or damaged, the file exists, or the disk is full.
    """
    if not (data / DATABASES[0]).is_file():
        raise BackupError(f"{data} has no {DATABASES[0]}; name the folder of a server (--data)")
    if target.exists():
        raise BackupError(f"{target} exists; name a new file")
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    scratch = target.with_name(f".{target.name}.{secrets.token_hex(4)}.db")
    try:
        for attempt in range(ATTEMPTS):
            try:
                summary = _write(data, part, scratch, report)
                break
            except _Collected as err:
                if attempt == ATTEMPTS - 1:
                    raise BackupError(f"{err}; run adverb doctor") from err
        os.replace(part, target)
        _sync_folder(target.parent)
    except (OSError, sqlite3.Error) as err:
        raise BackupError(f"the backup cannot be written: {err}") from err
    finally:
        for path in (part, scratch):
            path.unlink(missing_ok=True)
    return summary


def restore(source: Path, data: Path, *, report: Report = lambda done, total: None) -> Summary:
    """Restore a backup into a new data folder, which appears when everything in it has been checked.

    Parameters
    ----------
    source : Path
        A backup.
    data : Path
        A folder that does not exist or is empty.
    report : callable

    Raises
    ------
    BackupError
        The file is no complete backup, is of a newer version, or the folder is not empty.
    """
    if data.exists() and (not data.is_dir() or any(data.iterdir())):
        raise BackupError(f"{data} is not empty; name a new folder (--data)")
    part = data.absolute().with_name(f".{data.absolute().name}.{secrets.token_hex(4)}.part")
    try:
        part.mkdir(parents=True)
        with tarfile.open(source, "r:") as archive:
            summary = _extract(archive, part, report)
        _check(part)
        for folder in (part / BLOBS, part):
            _sync_folder(folder)
        if data.exists():
            data.rmdir()
        part.rename(data)
        _sync_folder(data.absolute().parent)
    except (OSError, tarfile.TarError, sqlite3.Error, EOFError) as err:
        raise BackupError(f"{source} cannot be restored: {err}") from err
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return summary


class _Collected(Exception):
    """An artifact of the copied database is missing."""


def _write(data: Path, part: Path, scratch: Path, report: Report) -> Summary:
    """Write all members, the database first."""
    with tarfile.open(part, "w:", format=tarfile.PAX_FORMAT) as archive:
        used: set[str] = set()
        count = 0
        for name in DATABASES:
            if not (data / name).is_file():
                continue
            _copy_database(data / name, scratch)
            if name == DATABASES[0]:
                used, count = _used(scratch), _versions(scratch)
            archive.add(scratch, name)
            scratch.unlink()
        files = sorted(path for path in data.glob("*.verb") if path.is_file())
        for path in files:
            archive.add(path, path.name)
        for done, sha256 in enumerate(sorted(used)):
            report(done, len(used))
            _add_blob(archive, data / BLOBS / f"{sha256}.verb", sha256)
        report(len(used), len(used))
        size = sum(member.size for member in archive.getmembers())
        summary = Summary(count, len(used), size, time.time())
        manifest = {"format": FORMAT, "layout": LAYOUT, "artifacts": len(used), "versions": count}
        content = json.dumps(manifest | {"created_at": summary.created_at_s}).encode()
        member = tarfile.TarInfo(MANIFEST)  # the last member: a file without it is incomplete
        member.size = len(content)
        archive.addfile(member, io.BytesIO(content))
    with part.open("rb") as file:
        os.fsync(file.fileno())
    return summary


def _copy_database(path: Path, target: Path) -> None:
    """Copy an SQLite database as of one moment, while others write to it."""
    address = f"{path.absolute().as_uri()}?mode=ro"
    with closing(sqlite3.connect(address, uri=True, timeout=30.0)) as source, closing(sqlite3.connect(target)) as copy:
        source.backup(copy)
        copy.execute("PRAGMA journal_mode = DELETE")


def _add_blob(archive: tarfile.TarFile, path: Path, sha256: str) -> None:
    try:
        file = path.open("rb")
    except FileNotFoundError as err:
        raise _Collected(f"artifact {sha256} is missing") from err
    with file:
        if hashlib.file_digest(file, "sha256").hexdigest() != sha256:
            raise BackupError(f"artifact {path} is damaged; restore it from an earlier backup, or delete its versions")
        file.seek(0)
        member = archive.gettarinfo(arcname=f"{BLOBS}/{path.name}", fileobj=file)
        archive.addfile(member, file)


def _extract(archive: tarfile.TarFile, folder: Path, report: Report) -> Summary:
    """Write the members of a backup to a folder; only regular files with known names."""
    (folder / BLOBS).mkdir()
    manifest: dict[str, Any] = {}
    done, size = 0, 0
    for member in archive:
        blob = _BLOB.fullmatch(member.name)
        if not member.isreg() or not (blob or member.name in (*DATABASES, MANIFEST) or _VERB.fullmatch(member.name)):
            raise BackupError(f"it has a member {member.name[:80]!r}, which no backup has")
        content = archive.extractfile(member)
        assert content is not None  # a regular file
        if member.name == MANIFEST:
            manifest = _manifest(content.read(MAX_MANIFEST))
            continue
        size += member.size
        sha256 = _copy(content, folder / member.name)
        if blob:
            if sha256 != blob[1]:
                raise BackupError(f"its artifact {blob[1]} is damaged")
            done += 1
            report(done, done)
    if not manifest:
        raise BackupError("it is not a complete backup: its last member is missing")
    return Summary(manifest["versions"], manifest["artifacts"], size, manifest["created_at"])


def _manifest(content: bytes) -> dict[str, Any]:
    try:
        found = json.loads(content)
        known: dict[str, Any] = {"versions": int(found["versions"]), "artifacts": int(found["artifacts"])}
        known |= {"created_at": float(found["created_at"])}
        form, layout = int(found["format"]), int(found["layout"])
    except (ValueError, KeyError, TypeError) as err:
        raise BackupError("its description cannot be read") from err
    if form > FORMAT or layout > LAYOUT:
        raise BackupError("it was made by a newer Adverb; restore it with that one")
    return known


def _copy(content: IO[bytes], target: Path) -> str:
    """Copy bytes to a new file; return their SHA-256."""
    digest = hashlib.sha256()
    with target.open("xb") as file:
        while chunk := content.read(CHUNK_BYTES):
            digest.update(chunk)
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest()


def _check(folder: Path) -> None:
    """Raise :class:`BackupError` unless the databases are intact and every artifact is there."""
    if not (folder / DATABASES[0]).is_file():
        raise BackupError(f"it has no {DATABASES[0]}")
    for name in DATABASES:
        if (folder / name).is_file():
            with closing(sqlite3.connect(folder / name)) as database:
                found = database.execute("PRAGMA integrity_check").fetchone()[0]
            if found != "ok":
                raise BackupError(f"its {name} is damaged: {found}")
    missing = [sha256 for sha256 in _used(folder / DATABASES[0]) if not (folder / BLOBS / f"{sha256}.verb").exists()]
    if missing:
        raise BackupError(f"its artifact {missing[0]} is missing")


def _used(database: Path) -> set[str]:
    """Hashes of the artifacts that a database names."""
    with closing(sqlite3.connect(database)) as connection:
        have = {(table, row[1]) for table, _ in _COLUMNS for row in connection.execute(f"PRAGMA table_info({table})")}
        queries = [f"SELECT DISTINCT {column} FROM {table}" for table, column in _COLUMNS if (table, column) in have]
        return {str(row[0]) for query in queries for row in connection.execute(query) if row[0]}


def _versions(database: Path) -> int:
    with closing(sqlite3.connect(database)) as connection:
        return int(connection.execute("SELECT count(*) FROM adverb_versions").fetchone()[0])


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder durable, where the system has a way to do it."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
