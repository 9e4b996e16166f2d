from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import replace

import pytest

from service.store.store import InvalidValue, Job, JobEnded, JobExists, UnknownJob

JOB = Job("j1", "reach", "queued", {"max_pseudo": 9}, {}, 0, 3, None, "", 10.0, 10.0)


def test_a_job_is_stored_unchanged(store):
    store.add_job(JOB)
    assert store.job("j1") == JOB
    with pytest.raises(JobExists, match="'j1' exists already"):
        store.add_job(JOB)
    with pytest.raises(UnknownJob, match="unknown refinement job 'j2'"):
        store.job("j2")


def test_jobs_are_listed_newest_first(store):
    for k, verb in enumerate(["reach", "punch", "reach"]):
        store.add_job(replace(JOB, id=f"j{k}", verb=verb, created_at_s=float(k)))
    assert [job.id for job in store.jobs()] == ["j2", "j1", "j0"]
    assert [job.id for job in store.jobs(verb="reach")] == ["j2", "j0"]
    assert [job.id for job in store.jobs(limit=1)] == ["j2"]


def test_a_job_changes_until_it_ends(store, clock):
    store.add_job(JOB)
    job = store.update_job("j1", state="running", progress={"share": 0.5})
    assert job == store.job("j1")
    assert (job.state, job.progress, job.updated_at_s) == ("running", {"share": 0.5}, clock.now_s)
    store.update_job("j1", state="published", version_after=4, detail="better by 12 %")
    store.update_job("j1", state="published")
    for other in ("running", "cancelled", "failed"):
        with pytest.raises(JobEnded, match="has ended .published."):
            store.update_job("j1", state=other, detail="too late")
    assert store.job("j1").detail == "better by 12 %"
    assert store.update_job("j1", progress={"share": 1.0}).state == "published"
    with pytest.raises(UnknownJob):
        store.update_job("j2", state="running")


def test_publishing_ends_a_job_or_fails_as_a_whole(store, artifact):
    store.add_job(JOB)
    version = store.publish("reach", artifact("one"), author="j1", reason="better", quality={}, ends="j1")
    job = store.job("j1")
    assert (job.state, job.version_after, job.detail) == ("published", version.number, "better")
    store.add_job(replace(JOB, id="j2"))
    store.update_job("j2", state="cancelled")
    with pytest.raises(JobEnded, match="has ended .cancelled."):
        store.publish("reach", artifact("two"), author="j2", reason="better", quality={}, ends="j2")
    with pytest.raises(UnknownJob):
        store.publish("reach", artifact("two"), author="j3", reason="better", quality={}, ends="j3")
    assert store.versions("reach") == [version]
    assert len(store.history("reach")) == 1


def test_either_cancelling_or_publishing_succeeds(location, store, artifact):
    other, file, published = location.open(), artifact("one"), 0
    for k in range(12):
        store.add_job(replace(JOB, id=f"j{k}", verb="reach"))
        file.write_text(str(k))
        barrier = threading.Barrier(2)

        def cancel(id=f"j{k}", barrier=barrier):
            barrier.wait(120)
            with suppress(JobEnded):
                other.update_job(id, state="cancelled")

        thread = threading.Thread(target=cancel)
        thread.start()
        barrier.wait(120)
        with suppress(JobEnded):
            store.publish("reach", file, author="test", reason="", quality={}, ends=f"j{k}")
        thread.join(120)
        job = store.job(f"j{k}")
        published += job.state == "published"
        assert job.version_after == (published if job.state == "published" else None)
    assert sum(store.ended_jobs().values()) == 12
    assert (store.current()["reach"].number if published else 0) == published
    other.close()


def test_unfinished_and_ended_jobs_are_listed(store):
    for k, state in enumerate(["queued", "running", "failed", "failed", "published"]):
        store.add_job(replace(JOB, id=f"j{k}", state=state, created_at_s=float(k)))
    store.add_job(replace(JOB, id="punch", verb="punch", state="failed"))
    assert [job.id for job in store.jobs(unfinished=True)] == ["j1", "j0"]
    assert store.jobs(verb="punch", unfinished=True) == []
    ended = {("reach", "failed"): 2, ("reach", "published"): 1, ("punch", "failed"): 1}
    assert store.ended_jobs() == ended


def test_invalid_jobs_are_refused(store):
    store.add_job(JOB)
    with pytest.raises(InvalidValue, match="'done' is not a state"):
        store.update_job("j1", state="done")
    with pytest.raises(InvalidValue, match="verb of a job cannot change"):
        store.update_job("j1", verb="punch")
    with pytest.raises(InvalidValue, match="1048576 bytes"):
        store.update_job("j1", progress={"x": "y" * 1_100_000})
    with pytest.raises(InvalidValue, match="not a state"):
        store.add_job(replace(JOB, id="j2", state="done"))
    assert store.job("j1") == JOB


def test_reaps_are_counted(store):
    store.add_job(JOB)
    assert [store.count_reap("j1") for _ in range(3)] == [1, 2, 3]
    assert store.job("j1").reaps == 3
    with pytest.raises(UnknownJob):
        store.count_reap("j2")


def test_usage_of_a_server_replaces_its_earlier_one(store):
    store.put_usage("reach", "a", {"cells": {"0,0": 1}}, 10.0)
    store.put_usage("reach", "a", {"cells": {"0,0": 2}}, 20.0)
    store.put_usage("reach", "b", {"cells": {"1,0": 5}}, 30.0)
    store.put_usage("punch", "a", {"cells": {}}, 30.0)
    assert store.usage("reach", not_before_s=0.0) == [{"cells": {"1,0": 5}}, {"cells": {"0,0": 2}}]
    assert store.usage("reach", not_before_s=20.5) == [{"cells": {"1,0": 5}}]
    assert store.usage("kick", not_before_s=0.0) == []


def test_usage_is_bounded(store):
    with pytest.raises(InvalidValue, match="'cells'"):
        store.put_usage("reach", "a", {"x": "y" * 1_100_000}, 1.0)
    with pytest.raises(InvalidValue, match="'server'"):
        store.put_usage("reach", "", {}, 1.0)
