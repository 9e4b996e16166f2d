"""Records the file operations of a block, and makes the folders that a power failure during it may leave behind.

The model is stricter than common file systems: without fsync of a file its content may be lost, wholly or in part, and
without fsync of a folder each change of its names may be lost by itself. SQLite is trusted: of its databases there is
the committed content of each moment.
"""

from __future__ import annotations

import itertools
import os
import shutil
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

MOST_PENDING = 3
"""Unsynced changes of names of which every subset is tried; of more: none, all, and each one alone."""

EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir")
FOLDER, GONE = 0, -1
"""In place of the number of an inode."""


class Moment:
    """What a power failure may leave at one moment.

    Parameters
    ----------
    label : str
        What happens at this moment.
    names : dict of Path to int
        Durable names and the inode of each.
    pending : list of dict
        Unsynced changes of names, each of which is lost or not.
    contents : dict of int to (bytes or None, bytes)
        Content of each inode at its last fsync, and now.
    databases : dict of Path to bytes
    """

    def __init__(self, label, names, pending, contents, databases):
        self.label, self.databases = label, databases
        self._names, self._pending, self._contents = dict(names), [dict(row) for row in pending], contents

    def outcomes(self) -> Iterator[dict[Path, bytes | None]]:
        """Names and contents (None for a folder) of each disk that is possible."""
        every = range(len(self._pending))
        subsets = [(), tuple(every), *((k,) for k in every)]
        if len(every) <= MOST_PENDING:
            subsets = [chosen for k in range(len(every) + 1) for chosen in itertools.combinations(every, k)]
        for chosen in subsets:
            names = dict(self._names)
            for k in chosen:
                names |= self._pending[k]
            left = {path: node for path, node in names.items() if node != GONE}
            for torn in (False, True):
                yield {path: None if node == FOLDER else self._content(node, torn) for path, node in left.items()}

    def _content(self, node: int, torn: bool) -> bytes:
        synced, now = self._contents[node]
        if synced is not None:
            return synced
        return now[: len(now) // 2] if torn else b""


class Recorder:
    """Follows the files of a folder; see :func:`recording`."""

    def __init__(self, root: Path, *, databases: bool) -> None:
        self.root, self.moments, self._databases = root, [], databases
        self._names, self._pending, self._contents = {}, [], {}
        self._nodes: dict[int, int] = {}
        self._moving: tuple[Path, Path] | None = None
        self._count, self.busy, self.on = 0, False, True
        self._names = self._seen()
        self._contents = {node: (path.read_bytes(),) * 2 for path, node in self._names.items() if node != FOLDER}

    def audit(self, event: str, arguments: tuple) -> None:
        """The audit hook: an operation of a name begins."""
        if self.on and not self.busy and event in EVENTS and isinstance(arguments[0], str | os.PathLike):
            path = Path(os.fspath(arguments[0])).absolute()
            if self.root in path.parents:
                self.mark(f"before {event} of {path.name}")
                if event == "os.rename" and path.is_dir():
                    self._moving = path, Path(os.fspath(arguments[1])).absolute()

    def synced(self, descriptor: int) -> None:
        """An fsync: of a file, its content is durable from now on; of a folder, its names."""
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        if not self.on or self.root not in (path, *path.parents):
            return
        self.mark(f"before fsync of {path.name}")
        if path.is_dir():
            for changes in [row for row in self._pending if any(name.parent == path for name in row)]:
                self._pending.remove(changes)
                self._names |= changes
        else:
            node = self._nodes[path.stat().st_ino]
            self._contents[node] = (path.read_bytes(),) * 2
        self.mark(f"after fsync of {path.name}")

    def mark(self, label: str) -> None:
        """Keep what a power failure would leave now."""
        self.busy = True
        seen = self._seen()
        self._move_folder()
        known = {name: node for row in (self._names, *self._pending) for name, node in row.items()}
        known = {name: node for name, node in known.items() if node != GONE}
        gone = [name for name in known if name not in seen]
        for name, node in seen.items():
            if known.get(name) != node:
                moved = [old for old in gone if node != FOLDER and known[old] == node]
                self._pending.append({name: node} | dict.fromkeys(moved, GONE))  # a rename is one change
                gone = [old for old in gone if old not in moved]
        self._pending += [{name: GONE} for name in gone]
        for name, node in seen.items():
            if node != FOLDER:
                self._contents[node] = (self._contents.get(node, (None,))[0], name.read_bytes())
        found = sorted(self.root.rglob("*.db")) if self._databases else []
        databases = {path: _committed(path) for path in found if path.stat().st_size}
        self.moments.append(Moment(label, self._names, self._pending, dict(self._contents), databases))
        self.busy = False

    def _move_folder(self) -> None:
        """Count a folder that was renamed, with all that is durable in it, as one change."""
        if self._moving is None:
            return
        (old, new), self._moving = self._moving, None

        def moved(path: Path) -> Path:
            return new / path.relative_to(old) if old in (path, *path.parents) else path

        rows = [row for row in self._pending if row != {old: FOLDER}]
        self._pending = [{moved(path): node for path, node in row.items()} for row in rows]
        inside = {path: node for path, node in self._names.items() if old in (path, *path.parents)}
        durable = {moved(path): node for path, node in inside.items()}
        self._pending.append({new: FOLDER} | durable | dict.fromkeys((old, *inside), GONE))

    def _seen(self) -> dict[Path, int]:
        """Names that exist, and the number of each inode; the system reuses its own numbers."""
        found = {path: path.lstat() for path in sorted(self.root.rglob("*")) if not self._is_database(path)}
        alive = {status.st_ino for status in found.values()}
        self._nodes = {inode: number for inode, number in self._nodes.items() if inode in alive}
        for status in found.values():
            if status.st_ino not in self._nodes:
                self._count += 1
                self._nodes[status.st_ino] = self._count
        return {path: FOLDER if path.is_dir() else self._nodes[status.st_ino] for path, status in found.items()}

    def _is_database(self, path: Path) -> bool:
        return self._databases and path.name.endswith((".db", ".db-wal", ".db-shm"))


@contextmanager
def recording(root: Path, *, databases: bool = True) -> Iterator[Recorder]:
    """Record what happens to the files of a folder.

    Parameters
    ----------
    root : Path
    databases : bool
        Whether ``*.db`` are databases that SQLite writes; otherwise they are files like others.
    """
    recorder, fsync = Recorder(root, databases=databases), os.fsync

    def sync(descriptor: int) -> None:
        fsync(descriptor)
        recorder.synced(descriptor)

    sys.addaudithook(recorder.audit)  # it stays, and does nothing after the block
    os.fsync = sync
    try:
        yield recorder
        recorder.mark("the end")
    finally:
        os.fsync, recorder.on = fsync, False


def restored(moment: Moment, root: Path, target: Path) -> Iterator[Path]:
    """The folder after a power failure, once for each possible outcome, always at the same place."""
    for outcome in moment.outcomes():
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        for path, content in sorted(outcome.items(), key=lambda row: len(row[0].parts)):
            place = target / path.relative_to(root)
            if place.parent.is_dir():  # else its folder is lost, and the file with it
                place.mkdir() if content is None else place.write_bytes(content)
        for path, content in moment.databases.items():
            (target / path.relative_to(root)).write_bytes(content)
        yield target


def _committed(path: Path) -> bytes:
    """Content of a database as of its last commit."""
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as source:
        return source.serialize()
