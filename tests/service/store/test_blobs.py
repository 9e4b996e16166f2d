from __future__ import annotations

import hashlib
import sys
import time

import obstore
import pytest
from obstore.store import LocalStore, MemoryStore

from service.store import blobs, jobs, ledger, notices, records, tables
from service.store import store as stores
from service.store.blobs import Bucket, Folder, open_blobs
from service.store.store import ArtifactMissing, BadAddress, Store, StoreUnavailable

BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}


def nothing(step: str) -> None:
    pass


@pytest.fixture(params=["memory", "file"])
def bucket(request, tmp_path) -> Bucket:
    (tmp_path / "bucket").mkdir()
    behind = MemoryStore() if request.param == "memory" else LocalStore(tmp_path / "bucket")
    return Bucket(behind, Folder(tmp_path / "cache"))


def test_a_damaged_copy_is_fetched_again(bucket, artifact):
    blob = bucket.put(artifact("one"), nothing)
    path = bucket.path(blob.sha256)
    path.write_bytes(b"garbage")
    assert bucket.path(blob.sha256).read_bytes() == b"one" * 1000
    path.unlink()
    assert bucket.path(blob.sha256).read_bytes() == b"one" * 1000


def test_a_changed_copy_of_the_same_length_is_detected(bucket, artifact):
    blob = bucket.put(artifact("one"), nothing)
    path = bucket.path(blob.sha256)
    path.write_bytes(b"two" * 1000)
    assert bucket.path(blob.sha256).read_bytes() == b"one" * 1000


def test_a_blob_damaged_in_the_bucket_is_refused(bucket, tmp_path, artifact):
    blob = bucket.put(artifact("one"), nothing)
    bucket.path(blob.sha256).unlink()
    obstore.put(bucket._store, blob.name, b"garbage")
    with pytest.raises(ArtifactMissing, match="damaged in its storage"):
        bucket.path(blob.sha256)
    assert list((tmp_path / "cache").iterdir()) == []


def test_a_bucket_lists_and_removes_its_own_blobs_only(bucket, artifact):
    one = bucket.put(artifact("one"), nothing)
    obstore.put(bucket._store, "notes.txt", b"foreign")
    assert [blob.name for blob in bucket.listing()] == [one.name]
    assert bucket.listing()[0].size_bytes == 3000
    assert abs(bucket.listing()[0].modified_at_s - time.time()) < 60
    bucket.remove([one, one])
    assert not bucket.has(one.sha256)
    assert bucket.path(one.sha256).exists()  # the copy
    bucket.path(one.sha256).unlink()
    with pytest.raises(ArtifactMissing, match="not in the bucket"):
        bucket.path(one.sha256)


def test_a_store_over_a_bucket(location, tmp_path, artifact):
    store = Store.open(location.database, "memory:///", cache=tmp_path / "cache")
    steps = []
    old = store.publish("reach", artifact("old"), **BY_ADA, at=steps.append)
    assert steps == ["write", "sync", "rename", "sync_folder", "upload", "transaction", "commit"]
    new = store.publish("reach", artifact("new"), **BY_ADA)
    store.path(new).write_bytes(b"garbage")
    assert store.path(new).read_bytes() == b"new" * 1000
    removed = store.collect(keep=1, now_s=time.time() + 30 * 86400.0)
    assert removed == ["reach 1", f"{old.sha256}.verb", f"cached {old.sha256}.verb"]
    with pytest.raises(ArtifactMissing):
        store.path(old)
    store.close()


def test_a_bucket_that_does_not_answer(tmp_path, artifact, monkeypatch):
    for name, value in {
        "AWS_ENDPOINT_URL": "http://127.0.0.1:9",  # a closed port
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "id",
        "AWS_SECRET_ACCESS_KEY": "hunter2",
        "AWS_REGION": "eu",
    }.items():
        monkeypatch.setenv(name, value)
    bucket = open_blobs("s3://verbs/prefix", cache=tmp_path / "cache")
    for call in (lambda: bucket.put(artifact("one"), nothing), lambda: bucket.path("0" * 64), bucket.listing):
        with pytest.raises(StoreUnavailable, match="the bucket cannot be") as caught:
            call()
        assert "hunter2" not in str(caught.value)


def test_a_damaged_blob_of_a_folder_is_refused(tmp_path, artifact):
    folder = Folder(tmp_path / "artifacts")
    blob = folder.put(artifact("one"), nothing)
    assert blob.sha256 == hashlib.sha256(b"one" * 1000).hexdigest()
    folder.path(blob.sha256).write_bytes(b"garbage")
    with pytest.raises(ArtifactMissing, match="is damaged"):
        folder.path(blob.sha256)
    assert folder.put(artifact("one"), nothing).sha256 == blob.sha256
    assert folder.path(blob.sha256).read_bytes() == b"one" * 1000


def test_file_addresses_are_folders(tmp_path, artifact):
    folder = tmp_path / "with space"
    blob = open_blobs(folder.as_uri()).put(artifact("one"), nothing)
    assert (folder / blob.name).exists()


def test_errors_of_unknown_schemes_list_the_known_ones(tmp_path):
    with pytest.raises(BadAddress, match="in a folder or at file://, s3://, gs://, az://, memory://, not at 'ftp://'"):
        open_blobs("ftp://host/path")


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "obstore.exceptions", None)
    with pytest.raises(BadAddress, match=r"adverb\[s3\]"):
        open_blobs("s3://bucket/prefix")


def test_packages_for_buckets_and_servers_are_not_imported_for_files(folder, artifact, monkeypatch):
    for name in ("obstore", "psycopg"):
        assert all(name not in vars(module) for module in (blobs, jobs, ledger, notices, records, stores, tables))
        monkeypatch.setitem(sys.modules, name, None)
    store = Store.open(f"sqlite:///{folder}/state.db", str(folder / "artifacts"))
    version = store.publish("reach", artifact("one"), **BY_ADA)
    assert store.path(version).exists()
    assert store.collect(now_s=time.time()) == []
    store.close()
