from __future__ import annotations

import mmap
import time

import pytest

from service.store.store import ArtifactMissing, Job, UnknownVersion
from verbs.verb import NAME

BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}
DAY_S = 86400.0


@pytest.fixture
def later_s() -> float:
    """A time at which all files and versions are old."""
    return time.time() + 30 * DAY_S


def fill(store, artifact, count: int, verb: str = "reach") -> list[str]:
    return [store.publish(verb, artifact(f"{verb} {k}"), **BY_ADA).sha256 for k in range(1, count + 1)]


def numbers(store, verb: str = "reach") -> list[int]:
    return [version.number for version in store.versions(verb)]


def job(verb: str, version: int, state: str = "running") -> Job:
    return Job(f"{verb}-{version}", verb, state, {}, {}, 0, version, None, "", 0.0, 0.0)


def test_the_newest_and_the_current_one_stay(store, location, artifact, later_s):
    blobs = fill(store, artifact, 8)
    store.activate("reach", 2, author="ada", reason="")
    removed = store.collect(keep=3, now_s=later_s)
    gone = [f"{blobs[k - 1]}.verb" for k in (1, 3, 4, 5)]
    assert removed == ["reach 1", "reach 3", "reach 4", "reach 5", *sorted(gone)]
    assert numbers(store) == [2, 6, 7, 8]
    assert location.files() == {f"{blobs[k - 1]}.verb" for k in (2, 6, 7, 8)}
    assert len(store.history("reach")) == 9
    with pytest.raises(UnknownVersion):
        store.activate("reach", 1, author="ada", reason="")
    assert store.collect(keep=3, now_s=later_s) == []
    assert store.publish("reach", artifact("reach 1"), **BY_ADA).number == 9


def test_fewer_than_kept_all_stay(store, artifact, later_s):
    fill(store, artifact, 4)
    assert store.collect(keep=5, now_s=later_s) == []


def test_young_versions_stay(store, artifact, clock):
    fill(store, artifact, 4)
    assert store.collect(keep=1, younger_s=100.0, now_s=clock.now_s + 97.5) == ["reach 1"]  # a second each apart
    assert numbers(store) == [2, 3, 4]


def test_what_jobs_refine_stays_until_they_end(store, artifact, later_s):
    fill(store, artifact, 4)
    store.add_job(job("reach", 1))
    store.add_job(job("reach", 2, "queued"))
    store.add_job(job("reach", 3, "failed"))
    store.collect(keep=1, now_s=later_s)
    assert numbers(store) == [1, 2, 4]
    store.update_job("reach-1", state="published")
    store.collect(keep=1, now_s=later_s)
    assert numbers(store) == [2, 4]


def test_a_shared_blob_stays_as_long_as_one_version_refers_to_it(store, location, artifact, later_s):
    blob = store.publish("reach", artifact("shared"), **BY_ADA).sha256
    other = store.publish("punch", artifact("shared"), **BY_ADA)
    store.publish("reach", artifact("next"), **BY_ADA)
    assert store.collect(keep=1, now_s=later_s) == ["reach 1"]
    assert f"{blob}.verb" in location.files()
    assert store.path(other).exists()


def test_a_deleted_verb_is_collected_when_it_is_old(store, location, artifact, clock):
    fill(store, artifact, 3)
    store.delete("reach", author="ada", reason="")
    store.collect(keep=2, younger_s=10.0, now_s=clock.now_s + 9.0)
    assert numbers(store) == [2, 3]
    store.collect(keep=2, younger_s=10.0, now_s=clock.now_s + 11.0)
    assert numbers(store) == []
    with pytest.raises(UnknownVersion):
        store.version("reach", 3)
    assert store.publish("reach", artifact("again"), **BY_ADA).number == 4


def test_blobs_and_temporary_files_younger_than_an_hour_stay(store, location, artifact, later_s):
    fill(store, artifact, 2)
    part, foreign = location.artifacts / ".0123456789abcdef.tmp", location.artifacts / "notes.txt"
    part.touch()
    foreign.touch()
    hour_s = part.stat().st_mtime + 3600.0
    assert store.collect(keep=1, younger_s=-later_s, now_s=hour_s - 60.0) == ["reach 1"]
    assert len(location.files()) == 4
    assert len(store.collect(keep=1, now_s=hour_s + 60.0)) == 2
    assert location.files() == {"notes.txt", f"{store.current()['reach'].sha256}.verb"}


def test_a_mapped_artifact_stays_readable_after_it_was_collected(store, artifact, later_s):
    old = store.publish("reach", artifact("old"), **BY_ADA)
    with store.path(old).open("rb") as file:
        block = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    store.publish("reach", artifact("new"), **BY_ADA)
    store.collect(keep=1, now_s=later_s)
    with pytest.raises(ArtifactMissing, match="may have been collected"):
        store.path(old)
    assert block[:] == b"old" * 1000
    block.close()


def test_a_blob_collected_while_it_is_published_again_is_written_again(store, location, artifact, later_s):
    store.publish("reach", artifact("old"), **BY_ADA)
    store.publish("reach", artifact("new"), **BY_ADA)
    other, steps = location.open(), []

    def interfere(step: str) -> None:
        steps.append(step)
        if steps.count("transaction") == 1 and step == "transaction":
            other.collect(keep=1, now_s=later_s)

    version = store.publish("reach", artifact("old"), **BY_ADA, at=interfere)
    assert steps.count("write") == 2
    assert store.path(version).read_bytes() == b"old" * 1000
    other.close()


def test_old_usage_is_removed(store):
    store.put_usage("reach", "a", {"n": 1}, 100.0)
    store.put_usage("reach", "b", {"n": 2}, 200.0)
    assert store.collect(younger_s=50.0, now_s=200.0) == ["usage of reach at a"]
    assert store.usage("reach", not_before_s=0.0) == [{"n": 2}]


def test_names_of_verbs_have_no_space():
    assert NAME.fullmatch("reach 3") is None  # so "reach 3" names a version
