"""Jobs survive the end of the processes that run them."""

from __future__ import annotations

import signal
import time
from functools import cache

import numpy as np
import pytest

from service.refinement import dbos_setup
from service.refinement.errors import AlreadyRunning
from tests.service.refinement.conftest import Cluster, until
from verbs import library
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.verb import Verb

REQUEST = {"target_error": 0.0, "max_pseudo": 20, "seed": 7}
LONG = REQUEST | {"max_pseudo": 2_000}


@cache
def offline() -> Verb:
    """arm3, refined by the library alone."""
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=20, seed=7)
    *_, last = refine(verb, rules)
    return with_basis(verb, last.basis, rules, last.mark)


def recorded(cluster: Cluster, job: str) -> int:
    """Number of finished steps that advanced a job."""
    client = dbos_setup.connect(cluster.url)
    try:
        return sum(step["function_name"] == "advance" for step in client.list_workflow_steps(job))
    finally:
        client.destroy()


def test_killed_worker_is_replaced_and_no_finished_step_is_repeated(cluster: Cluster):
    cluster.start_workers("a", "b")
    job = cluster.queue.start(cluster.publish("killed"), None, REQUEST, "test")
    dead = cluster.worker_of(job, steps=5)
    dead.end(signal.SIGKILL)
    killed_s, finished = time.time(), recorded(cluster, job.id)
    (other,) = (worker for worker in cluster.workers.values() if worker is not dead)
    assert until(lambda: other.lines("step done", job=job.id))[0]["timestamp"] - killed_s < 5.0
    row = cluster.wait_for_end(job)
    assert (row.state, row.version_after, row.reaps) == ("published", 2, 1)
    assert [version.number for version in cluster.store.versions("killed")] == [1, 2]
    assert len(other.lines("step done", job=job.id)) == recorded(cluster, job.id) - finished
    published = artifact.load(cluster.store.path(cluster.store.version("killed", 2)))
    for key in ("centers", "radii", "radial", "poly"):
        assert np.array_equal(getattr(published.bases["refined"], key), getattr(offline().bases["refined"], key))
    assert published.quality == offline().quality
    assert published.provenance == offline().provenance
    until(lambda: not list(cluster.folder.glob("verbs/jobs/*")))  # removed after the job's end is recorded


def test_worker_that_was_wrongly_declared_dead_does_no_harm(cluster: Cluster):
    cluster.start_workers("a", "b")
    job = cluster.queue.start(cluster.publish("doubted"), None, REQUEST, "test")
    doubted = cluster.worker_of(job, steps=3)
    (other,) = (worker for worker in cluster.workers.values() if worker is not doubted)
    client = dbos_setup.connect(cluster.url)
    client.resume_workflow(job.id, queue_name=dbos_setup.QUEUE)
    client.destroy()
    row = cluster.wait_for_end(job)
    until(lambda: doubted.lines("job closed", job=job.id) or other.lines("job closed", job=job.id))
    assert row.state == "published"
    assert [version.number for version in cluster.store.versions("doubted")] == [1, 2]
    done = sum(len(worker.lines("step done", job=job.id)) for worker in (doubted, other))
    assert done <= recorded(cluster, job.id) + 1


def test_worker_hands_its_job_back_on_sigterm(cluster: Cluster):
    cluster.start_workers("a", "b")
    job = cluster.queue.start(cluster.publish("stopped"), None, REQUEST, "test")
    stopped = cluster.worker_of(job, steps=2)
    began_s = time.monotonic()
    assert stopped.end(signal.SIGTERM) == 0
    assert time.monotonic() - began_s < 10.0
    row = cluster.wait_for_end(job)
    assert (row.state, row.reaps) == ("published", 0)


def test_cancelled_job_ends_within_a_step(cluster: Cluster):
    cluster.start_workers("a", "b")
    name = cluster.publish("cancelled")
    job = cluster.queue.start(name, None, LONG, "test")
    runner = cluster.worker_of(job)
    with pytest.raises(AlreadyRunning) as caught:
        cluster.queue.start(name, None, REQUEST, "test")
    assert caught.value.job == job.id
    assert cluster.queue.cancel(job.id, author="me").state == "cancelled"
    cancelled_s, done = time.time(), len(runner.lines("step done", job=job.id))
    closed = until(lambda: runner.lines("job closed", job=job.id))
    assert closed[0]["timestamp"] - cancelled_s < 2.0
    assert len(runner.lines("step done", job=job.id)) <= done + 1
    row = cluster.store.job(job.id)
    assert (row.state, row.detail) == ("cancelled", "cancelled by me")
    assert len(cluster.store.versions(name)) == 1
    again = cluster.queue.start(name, None, LONG, "test")
    cluster.queue.cancel(again.id, author="me")


def test_job_that_loses_three_workers_is_given_up(cluster: Cluster):
    cluster.start_workers("a", "b")
    name = cluster.publish("deadly")
    job = cluster.queue.start(name, None, LONG, "test")
    for _ in range(3):
        cluster.worker_of(job).end(signal.SIGKILL)
        cluster.start_workers("a", "b")
    row = cluster.wait_for_end(job)
    assert (row.state, row.reaps) == ("given_up", 3)
    assert "3 times" in row.detail
    assert cluster.store.current()[name].number == 1


def test_restarted_worker_resumes_its_own_job(cluster: Cluster):
    cluster.start_workers("a", "b")
    for worker in cluster.workers.values():
        worker.end(signal.SIGKILL)
    (only,) = cluster.start_workers("a")
    job = cluster.queue.start(cluster.publish("restarted"), None, REQUEST, "test")
    cluster.worker_of(job, steps=3)
    only.end(signal.SIGKILL)
    cluster.start_workers("a")
    row = cluster.wait_for_end(job)
    assert (row.state, row.reaps) == ("published", 1)


def test_urgent_jobs_run_first(cluster: Cluster):
    for worker in cluster.workers.values():
        worker.end(signal.SIGKILL)
    requested = REQUEST | {"max_pseudo": 1}
    jobs = [
        cluster.queue.start(cluster.publish(f"urgent-{priority}"), None, requested | {"priority": priority}, "test")
        for priority in (50, 100, 1)
    ]
    (only,) = cluster.start_workers("a")
    for job in jobs:
        cluster.wait_for_end(job)
    assert [row["verb"] for row in only.lines("job begun")] == ["urgent-1", "urgent-50", "urgent-100"]


def test_restart_of_the_database_only_delays_a_job(cluster: Cluster, request):
    if cluster.url.startswith("sqlite"):
        pytest.skip("a file does not restart")
    postgres = request.getfixturevalue("postgres")
    cluster.start_workers("a", "b")
    job = cluster.queue.start(cluster.publish("patient"), None, REQUEST, "test")
    cluster.worker_of(job, steps=3)
    postgres.stop()
    postgres.start()
    row = cluster.wait_for_end(job)
    assert (row.state, row.reaps) == ("published", 0)
    assert len(cluster.store.versions("patient")) == 2
