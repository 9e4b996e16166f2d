"""Jobs outlive the processes that run them, whichever way these end."""

from __future__ import annotations

import signal
import time
from functools import cache

import numpy as np
import pytest

from service.refinement import engine
from service.refinement.errors import AlreadyRunning
from tests.service.refinement.conftest import Place, until
from verbs import library
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.verb import Verb

ASKED = {"target_error": 0.0, "max_pseudo": 20, "seed": 7}
LONG = ASKED | {"max_pseudo": 2_000}


@cache
def offline() -> Verb:
    """What the library alone makes of arm3."""
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=20, seed=7)
    *_, last = refine(verb, rules)
    return with_basis(verb, last.basis, rules, last.mark)


def recorded(place: Place, job: str) -> int:
    """Finished steps that advanced a job."""
    client = engine.connect(place.url)
    try:
        return sum(step["function_name"] == "advance" for step in client.list_workflow_steps(job))
    finally:
        client.destroy()


def test_killed_worker_is_replaced_and_no_finished_step_is_repeated(place: Place):
    place.hire("a", "b")
    job = place.queue.start(place.publish("killed"), None, ASKED, "test")
    dead = place.runner(job, steps=5)
    dead.end(signal.SIGKILL)
    killed_s, finished = time.time(), recorded(place, job.id)
    (other,) = (worker for worker in place.workers.values() if worker is not dead)
    assert until(lambda: other.lines("step done", job=job.id))[0]["timestamp"] - killed_s < 5.0
    row = place.ended(job)
    assert (row.state, row.version_after, row.reaps) == ("published", 2, 1)
    assert [version.number for version in place.store.versions("killed")] == [1, 2]
    assert len(other.lines("step done", job=job.id)) == recorded(place, job.id) - finished
    published = artifact.load(place.store.path(place.store.version("killed", 2)))
    for key in ("centers", "radii", "radial", "poly"):
        assert np.array_equal(getattr(published.bases["refined"], key), getattr(offline().bases["refined"], key))
    assert published.quality == offline().quality
    assert published.provenance == offline().provenance
    assert not list(place.folder.glob("verbs/jobs/*"))


def test_worker_that_was_wrongly_declared_dead_does_no_harm(place: Place):
    place.hire("a", "b")
    job = place.queue.start(place.publish("doubted"), None, ASKED, "test")
    doubted = place.runner(job, steps=3)
    (other,) = (worker for worker in place.workers.values() if worker is not doubted)
    client = engine.connect(place.url)
    client.resume_workflow(job.id, queue_name=engine.QUEUE)
    client.destroy()
    row = place.ended(job)
    until(lambda: doubted.lines("job closed", job=job.id) or other.lines("job closed", job=job.id))
    assert row.state == "published"
    assert [version.number for version in place.store.versions("doubted")] == [1, 2]
    done = sum(len(worker.lines("step done", job=job.id)) for worker in (doubted, other))
    assert done <= recorded(place, job.id) + 1


def test_worker_that_is_told_to_stop_hands_its_job_back(place: Place):
    place.hire("a", "b")
    job = place.queue.start(place.publish("stopped"), None, ASKED, "test")
    stopped = place.runner(job, steps=2)
    began_s = time.monotonic()
    assert stopped.end(signal.SIGTERM) == 0
    assert time.monotonic() - began_s < 10.0
    row = place.ended(job)
    assert (row.state, row.reaps) == ("published", 0)


def test_cancelled_job_ends_within_a_step(place: Place):
    place.hire("a", "b")
    name = place.publish("cancelled")
    job = place.queue.start(name, None, LONG, "test")
    runner = place.runner(job)
    with pytest.raises(AlreadyRunning) as caught:
        place.queue.start(name, None, ASKED, "test")
    assert caught.value.job == job.id
    assert place.queue.cancel(job.id, author="me").state == "cancelled"
    cancelled_s, done = time.time(), len(runner.lines("step done", job=job.id))
    closed = until(lambda: runner.lines("job closed", job=job.id))
    assert closed[0]["timestamp"] - cancelled_s < 2.0
    assert len(runner.lines("step done", job=job.id)) <= done + 1
    row = place.store.job(job.id)
    assert (row.state, row.detail) == ("cancelled", "cancelled by me")
    assert len(place.store.versions(name)) == 1
    again = place.queue.start(name, None, LONG, "test")
    place.queue.cancel(again.id)


def test_job_that_loses_three_workers_is_given_up(place: Place):
    place.hire("a", "b")
    name = place.publish("deadly")
    job = place.queue.start(name, None, LONG, "test")
    for _ in range(3):
        place.runner(job).end(signal.SIGKILL)
        place.hire("a", "b")
    row = place.ended(job)
    assert (row.state, row.reaps) == ("given_up", 3)
    assert "3 times" in row.detail
    assert place.store.current()[name].number == 1


def test_restarted_worker_goes_on_with_its_own_job(place: Place):
    place.hire("a", "b")
    for worker in place.workers.values():
        worker.end(signal.SIGKILL)
    (only,) = place.hire("a")
    job = place.queue.start(place.publish("restarted"), None, ASKED, "test")
    place.runner(job, steps=3)
    only.end(signal.SIGKILL)
    place.hire("a")
    row = place.ended(job)
    assert (row.state, row.reaps) == ("published", 1)


def test_urgent_jobs_are_served_first(place: Place):
    for worker in place.workers.values():
        worker.end(signal.SIGKILL)
    asked = ASKED | {"max_pseudo": 1}
    jobs = [
        place.queue.start(place.publish(f"urgent-{priority}"), None, asked | {"priority": priority}, "test")
        for priority in (50, 100, 1)
    ]
    (only,) = place.hire("a")
    for job in jobs:
        place.ended(job)
    assert [row["verb"] for row in only.lines("job begun")] == ["urgent-1", "urgent-50", "urgent-100"]


def test_database_that_restarts_delays_a_job_and_no_more(place: Place, request):
    if place.url.startswith("sqlite"):
        pytest.skip("a file does not restart")
    postgres = request.getfixturevalue("postgres")
    place.hire("a", "b")
    job = place.queue.start(place.publish("patient"), None, ASKED, "test")
    place.runner(job, steps=3)
    postgres.stop()
    postgres.start()
    row = place.ended(job)
    assert (row.state, row.reaps) == ("published", 0)
    assert len(place.store.versions("patient")) == 2
