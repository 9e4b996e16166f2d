"""Power failures between any two file operations of the store, of backups and of restorations."""

import hashlib
import sqlite3
import tempfile
import time
from contextlib import closing
from pathlib import Path

import pytest

from service.store.backup import backup, restore
from service.store.drafts import Content
from service.store.store import ArtifactMissing, Store, UnknownVerb
from tests.service.faults.recorder import recording, restored
from tools.postgres import memory

BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}
HOUR_S = 3600.0


def opened(folder):
    return Store.open(f"sqlite:///{folder}/state.db", str(folder / "artifacts"))


@pytest.fixture
def root():
    with tempfile.TemporaryDirectory(prefix="power-", dir=memory()) as path:
        yield Path(path)


def checked(folder, promised):
    """Open a store after a power failure: all that was answered is there, and all that is there is whole."""
    store = opened(folder)
    try:
        for version in [row for verb in ("reach", "kick") for row in versions_of(store, verb)]:
            assert hashlib.sha256(store.path(version).read_bytes()).hexdigest() == version.sha256
            assert store.path(version).stat().st_size == version.size_bytes
            source = store.source(version)
            assert source is None or hashlib.sha256(source.read_bytes()).hexdigest() == version.source_sha256
        for draft in store.drafts.listed():
            for sha256 in filter(None, (draft.archive, draft.motion, draft.artifact)):
                assert hashlib.sha256(store.drafts.path(sha256).read_bytes()).hexdigest() == sha256
        for holds in promised:
            assert holds(store)
        assert store.collect(now_s=time.time() + 2 * HOUR_S) is not None
        for version in store.current().values():
            assert store.path(version).exists()
    finally:
        store.close()


def versions_of(store, verb):
    try:
        return store.versions(verb)
    except UnknownVerb:
        return []


class Script:
    """Changes of a store; ``promised`` grows with each that returns."""

    def __init__(self, folder, files, recorder):
        self.store, self.files, self.recorder = opened(folder), files, recorder
        self.promised, self.at = [], []

    def did(self, holds, *, ends=()):
        """A call has returned: from this moment on something holds, and some promises end."""
        self.promised = [one for one in self.promised if one not in ends] + [holds]
        self.at.append((len(self.recorder.moments), list(self.promised)))
        self.recorder.mark("a call returned")

    def begins(self, *ends):
        """Before a call that takes something away."""
        self.promised = [one for one in self.promised if one not in ends]
        self.at.append((len(self.recorder.moments), list(self.promised)))

    def promises(self, number):
        """What holds at a moment."""
        return next((held for first, held in reversed(self.at) if first <= number), [])

    def file(self, text):
        path = self.files / text
        path.write_text(text * 1000)
        return path


def test_no_power_failure_damages_a_store_or_takes_back_what_it_answered(root, record_property):
    data, files = root / "data", root / "files"
    data.mkdir()
    files.mkdir()
    with recording(data) as recorder:
        script = Script(data, files, recorder)
        run(script)
        script.store.close()
    for kind in ("before open of .", "before fsync of .", "before os.rename", "after fsync", "before os.remove"):
        assert any(moment.label.startswith(kind) for moment in recorder.moments), kind
    count = 0
    for number, moment in enumerate(recorder.moments):
        for folder in restored(moment, data, root / "after"):
            count += 1
            try:
                checked(folder, script.promises(number))
            except (AssertionError, ArtifactMissing) as err:
                raise AssertionError(f"after a power failure at moment {number}, {moment.label}: {err}") from err
    assert count > 100
    record_property("power failures replayed", count)


def run(script):
    """Publish, change drafts and keys, delete, and collect."""
    store = script.store
    one = store.publish("reach", script.file("one"), **BY_ADA)
    script.did(first := lambda store: store.version("reach", 1) == one)
    two = store.publish("reach", script.file("two"), source=script.file("source"), **BY_ADA)
    script.did(second := lambda store: store.current()["reach"] == two)
    content = Content("d", 1, 0, "{}", script.file("archive"), script.file("motion"), script.file("artifact"))
    draft = store.drafts.add("d1", content, most=9, most_bytes=10**9)
    script.did(kept := lambda store: store.drafts.get("d1") == draft)
    script.begins(kept)
    changed = store.drafts.change("d1", 1, Content("d", 1, 0, "{}", script.file("archive"), script.file("other"), None))
    script.did(kept := lambda store: store.drafts.get("d1") == changed)
    key = store.keys.add("k1", "0" * 64, name="", scopes=frozenset({"pose"}), expires_at_s=None)
    script.did(valid := lambda store: store.keys.listed() == [key])
    script.begins(valid)
    store.keys.revoke("k1")
    script.did(lambda store: store.keys.listed()[0].revoked_at_s is not None)
    script.begins(second)
    store.activate("reach", 1, author="ada", reason="back")
    script.did(active := lambda store: store.current()["reach"] == one)
    store.publish("kick", script.file("three"), **BY_ADA)
    script.did(lambda store: store.current()["kick"].number == 1)
    script.begins(active, kept)
    store.delete("reach", author="ada", reason="gone")
    script.did(lambda store: "reach" not in store.current())
    store.drafts.delete("d1")
    script.did(lambda store: store.drafts.listed() == [])
    script.begins(first)
    removed = store.collect(keep=1, younger_s=0.0, now_s=time.time() + 2 * HOUR_S)
    assert "reach 1" in removed
    assert sum(name.endswith(".verb") for name in removed) > 3
    script.did(lambda store: versions_of(store, "reach") == [])


def test_a_backup_and_its_restoration_are_whole_or_missing(root):
    data, files, place = root / "data", root / "files", root / "place"
    for folder in (data, files, place):
        folder.mkdir()
    store = opened(data)
    for text in ("one", "two"):
        (files / text).write_text(text * 1000)
        store.publish("reach", files / text, **BY_ADA)
    store.close()
    with recording(place, databases=False) as recorder:
        backup(data, place / "b.tar")
        made = len(recorder.moments)
        recorder.mark("the backup is made")
        restore(place / "b.tar", place / "new")
        done = len(recorder.moments)
        recorder.mark("it is restored")
    for number, moment in enumerate(recorder.moments):
        for folder in restored(moment, place, root / "after"):
            assert number < made or (folder / "b.tar").exists(), moment.label
            assert number < done or (folder / "new").exists(), moment.label
            if (folder / "b.tar").exists():
                restore(folder / "b.tar", folder / "again")
                assert complete(folder / "again"), moment.label
            if (folder / "new").exists():
                assert complete(folder / "new"), moment.label


def complete(folder):
    store = opened(folder)
    try:
        return [store.path(version).read_bytes() for version in store.versions("reach")] == [
            b"one" * 1000,
            b"two" * 1000,
        ]
    finally:
        store.close()


def test_each_commit_is_durable(root):
    """SQLite syncs its log at each commit (synchronous = FULL), so that nothing that was answered is lost."""
    store = opened(root)
    with store._database.transaction(writes=True) as connection:
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
    store.close()
    with closing(sqlite3.connect(root / "state.db")) as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
