"""Backups are complete while servers write, and nothing incomplete is restored."""

from __future__ import annotations

import hashlib
import io
import json
import random
import sqlite3
import tarfile
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

import service.cli  # noqa: F401 - adds its commands
from service.store.backup import MANIFEST, BackupError, backup, restore
from service.store.store import Store
from verbs import cli
from verbs.library import names

LIBRARY = Path(__file__).parents[3] / "verbs" / "library"


def opened(folder: Path) -> Store:
    return Store.open(f"sqlite:///{folder / 'state.db'}", str(folder / "artifacts"))


def published(store: Store, name: str, **options) -> int:
    file = LIBRARY / f"{name}.verb"
    return store.publish(name, file, author="ada", reason="test", quality={}, **options).number


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    store = opened(folder)
    for name in names()[:3]:
        published(store, name)
    published(store, names()[0], source=LIBRARY / "arm3" / "verb.toml")
    store.close()
    return folder


def contents(folder: Path):
    store = opened(folder)
    try:
        return {
            name: [(row.number, store.path(row).read_bytes(), row.author) for row in store.versions(name)]
            for name in store.current()
        }
    finally:
        store.close()


def test_a_restored_folder_has_everything(data, tmp_path):
    made = backup(data, tmp_path / "b.tar")
    found = restore(tmp_path / "b.tar", tmp_path / "new")
    assert made == found
    assert (made.versions, made.artifacts) == (3, 4)
    assert contents(tmp_path / "new") == contents(data)
    assert {path.name for path in tmp_path.iterdir()} == {"data", "b.tar", "new"}  # nothing half is left


def test_a_backup_is_complete_while_versions_are_published_and_collected(data, tmp_path):
    """A writer publishes, deletes and collects without a pause; each backup restores and is consistent."""
    stop, failures = threading.Event(), []

    def write():
        store, now = opened(data), 1e10
        try:
            for k in range(10_000):
                if stop.is_set():
                    break
                name = names()[k % 5]
                content = (tmp_path / "w.verb").resolve()
                content.write_bytes((LIBRARY / f"{name}.verb").read_bytes() + bytes([k % 250]))
                store.publish(name, content, author="bob", reason=str(k), quality={})
                if k % 7 == 0:
                    store.collect(keep=1, younger_s=-1e9, now_s=now)
        except Exception as err:
            failures.append(err)
        finally:
            store.close()

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for k in range(5):
            backup(data, tmp_path / f"{k}.tar")
            restore(tmp_path / f"{k}.tar", tmp_path / f"new{k}")
            assert contents(tmp_path / f"new{k}")
    finally:
        stop.set()
        writer.join()
    assert not failures


def test_a_damaged_artifact_is_named_and_no_file_is_left(data, tmp_path):
    blob = next((data / "artifacts").glob("*.verb"))
    content = bytearray(blob.read_bytes())
    content[100] ^= 1
    blob.write_bytes(content)
    with pytest.raises(BackupError, match=blob.stem):
        backup(data, tmp_path / "b.tar")
    blob.unlink()
    with pytest.raises(BackupError, match=f"artifact {blob.stem} is missing"):
        backup(data, tmp_path / "b.tar")
    assert {path.name for path in tmp_path.iterdir()} == {"data"}


def test_nothing_is_overwritten(data, tmp_path):
    (tmp_path / "b.tar").write_text("mine")
    with pytest.raises(BackupError, match="exists"):
        backup(data, tmp_path / "b.tar")
    backup(data, tmp_path / "c.tar")
    with pytest.raises(BackupError, match="not empty"):
        restore(tmp_path / "c.tar", data)
    (tmp_path / "empty").mkdir()
    restore(tmp_path / "c.tar", tmp_path / "empty")


def test_a_folder_without_a_database_is_named(tmp_path):
    with pytest.raises(BackupError, match="has no state.db"):
        backup(tmp_path, tmp_path / "b.tar")


@pytest.mark.parametrize("seed", range(25))
def test_a_cut_or_changed_backup_is_refused_or_equal(data, tmp_path, seed):
    backup(data, tmp_path / "b.tar")
    content = bytearray((tmp_path / "b.tar").read_bytes())
    rng = random.Random(seed)
    if seed % 2:
        content = content[: rng.randrange(len(content))]
    else:
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    (tmp_path / "c.tar").write_bytes(content)
    try:
        restore(tmp_path / "c.tar", tmp_path / "new")
    except BackupError:
        assert not (tmp_path / "new").exists()
        return
    assert contents(tmp_path / "new") == contents(data)  # a changed byte of padding or of a time


def packed(tmp_path: Path, members: dict[str, bytes], *, kind: bytes = tarfile.REGTYPE, link: str = "") -> Path:
    path = tmp_path / "made.tar"
    with tarfile.open(path, "w:") as archive:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size, member.type, member.linkname = len(content), kind, link
            archive.addfile(member, io.BytesIO(content))
    return path


@pytest.mark.parametrize(
    "name",
    ["../evil.verb", "/tmp/evil.verb", "artifacts/../../evil", "a/b.verb", "artifacts/short.verb", ".hidden.verb"],
)
def test_members_cannot_leave_the_folder(tmp_path, name):
    with pytest.raises(BackupError):
        restore(packed(tmp_path, {name: b"x"}), tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE])
def test_links_and_others_are_refused(tmp_path, kind):
    with pytest.raises(BackupError, match="which no backup has"):
        restore(packed(tmp_path, {"state.db": b""}, kind=kind, link="/etc/passwd"), tmp_path / "new")


NEWER = {"format": 9, "layout": 1, "versions": 0, "artifacts": 0, "created_at": 0}


@pytest.mark.parametrize("manifest", [b"{", b"[]", b'{"format": "x"}', json.dumps(NEWER).encode()])
def test_a_wrong_manifest_is_refused(tmp_path, manifest):
    with pytest.raises(BackupError):
        restore(packed(tmp_path, {MANIFEST: manifest}), tmp_path / "new")


def test_a_missing_artifact_is_noticed(data, tmp_path):
    with tarfile.open(tmp_path / "c.tar", "w:") as target:
        backup(data, tmp_path / "b.tar")
        with tarfile.open(tmp_path / "b.tar") as source:
            left_out = next(member.name for member in source if member.name.startswith("artifacts/"))
            for member in source:
                if member.name != left_out:
                    target.addfile(member, source.extractfile(member))
    with pytest.raises(BackupError, match="is missing"):
        restore(tmp_path / "c.tar", tmp_path / "new")


def test_the_commands(data, tmp_path):
    run = CliRunner().invoke
    made = run(cli.app, ["backup", "--data", str(data), "-o", str(tmp_path / "b.tar")])
    assert made.exit_code == 0, made.stderr
    assert "4 artifacts" in made.stderr
    assert run(cli.app, ["restore", str(tmp_path / "b.tar"), "--data", str(tmp_path / "new")]).exit_code == 0
    again = run(cli.app, ["restore", str(tmp_path / "b.tar"), "--data", str(tmp_path / "new")])
    assert (again.exit_code, "is not empty" in again.stderr) == (1, True)
    none = run(cli.app, ["restore", str(tmp_path / "none.tar"), "--data", str(tmp_path / "other")])
    assert (none.exit_code, "cannot be restored" in none.stderr) == (1, True)


def test_other_databases_are_not_backed_up_by_halves(data, tmp_path, monkeypatch):
    monkeypatch.setenv("ADVERB_DATABASE_URL", "postgresql://somewhere/db")
    answer = CliRunner().invoke(cli.app, ["backup", "--data", str(data), "-o", str(tmp_path / "b.tar")])
    assert (answer.exit_code, "pg_dump" in answer.stderr) == (1, True)


def test_the_database_of_a_backup_is_whole(data, tmp_path):
    backup(data, tmp_path / "b.tar")
    with tarfile.open(tmp_path / "b.tar") as archive:
        archive.extract("state.db", tmp_path / "out", filter="data")
        digests = {
            member.name: hashlib.sha256(archive.extractfile(member).read()).hexdigest()
            for member in archive
            if member.name.startswith("artifacts/")
        }
    assert all(name == f"artifacts/{digest}.verb" for name, digest in digests.items())
    database = sqlite3.connect(tmp_path / "out" / "state.db")
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()
