"""The queue of jobs, and the reaper; no worker runs here."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import pytest

from service.refinement import dbos_setup
from service.refinement.errors import AlreadyRunning
from service.refinement.queue import Refinements
from service.refinement.worker.locks import locks_of
from service.refinement.worker.reaper import KEPT_S, Reaper
from service.store.records import ENDED, Job, StoreUnavailable, UnknownJob, UnknownVerb, UnknownVersion
from service.store.store import Store
from tests.service.refinement.conftest import JobFixture
from verbs.errors import OutOfRange


@dataclass
class QueueFixture:
    store: Store
    queue: Refinements
    client: object
    reaper: Reaper
    running: set[str]
    now_s: float

    def statuses(self) -> dict[str, str]:
        return {row.workflow_id: row.status for row in self.client.list_workflows(name=dbos_setup.WORKFLOW)}


@pytest.fixture
def jobs(fixture: JobFixture) -> Iterator[QueueFixture]:
    fixture.publish()
    url = f"sqlite:///{fixture.folder}/state.db"
    dbos_setup.prepare(url)
    client, locks = dbos_setup.connect(url), locks_of(url)
    artifacts = str(fixture.folder / "verbs")
    running: set[str] = set()
    options = {"artifacts": artifacts, "running": running, "clock": lambda: found.now_s}
    reaper = Reaper(fixture.store, client, locks, "me", **options)
    found = QueueFixture(fixture.store, Refinements(url, fixture.store), client, reaper, running, 1e10)
    yield found
    found.queue.close()
    client.destroy()


def test_job_is_queued_once_to_a_verb(jobs: QueueFixture):
    job = jobs.queue.start("arm3", None, {"priority": 3}, "me")
    assert (job.state, job.version_before, job.request["author"], job.request["priority"]) == ("queued", 1, "me", 3)
    assert jobs.queue.job(job.id) == job
    assert jobs.queue.jobs(verb="arm3") == [job]
    with pytest.raises(AlreadyRunning) as caught:
        jobs.queue.start("arm3", 1, {}, "me")
    assert caught.value.job == job.id
    forced = jobs.queue.start("arm3", 1, {}, "me", force=True)
    assert jobs.statuses() == {job.id: "ENQUEUED", forced.id: "ENQUEUED"}


def test_second_of_two_concurrent_starts_is_refused(jobs: QueueFixture, monkeypatch):
    first = jobs.queue.start("arm3", None, {}, "me")
    refuse = jobs.queue._refuse_second
    monkeypatch.setattr(jobs.queue, "_refuse_second", lambda verb, new=None: refuse(verb, new) if new else None)
    with pytest.raises(AlreadyRunning):
        jobs.queue.start("arm3", None, {}, "me")
    assert sorted(job.state for job in jobs.queue.jobs()) == ["cancelled", "queued"]
    assert list(jobs.statuses()) == [first.id]


def test_cancelled_job_leaves_the_queue_and_the_verb_is_free(jobs: QueueFixture):
    job = jobs.queue.start("arm3", None, {}, "me")
    assert jobs.queue.cancel(job.id, author="you").detail == "cancelled by you"
    assert jobs.statuses() == {job.id: "CANCELLED"}
    assert jobs.queue.cancel(job.id, author="me").detail == "cancelled by you"
    jobs.queue.start("arm3", None, {}, "me")


def test_job_that_publishes_while_it_is_being_cancelled_stays_published(jobs: QueueFixture, monkeypatch):
    job, read = jobs.queue.start("arm3", None, {}, "me"), jobs.store.job

    def read_before_the_last_step(id: str) -> Job:
        found = read(id)
        if found.state not in ENDED:
            jobs.store.update_job(id, state="published", version_after=2, detail="better")
        return found

    monkeypatch.setattr(jobs.store, "job", read_before_the_last_step)
    found = jobs.queue.cancel(job.id, author="me")
    assert (found.state, found.version_after, found.detail) == ("published", 2, "better")


def test_unknown_verbs_versions_and_parameters_are_refused(jobs: QueueFixture):
    with pytest.raises(UnknownVerb):
        jobs.queue.start("nothing", None, {}, "me")
    with pytest.raises(UnknownVersion):
        jobs.queue.start("arm3", 7, {}, "me")
    with pytest.raises(OutOfRange):
        jobs.queue.start("arm3", None, {"max_pseudo": -1}, "me")
    with pytest.raises(UnknownJob):
        jobs.queue.cancel("nothing", author="me")
    assert jobs.queue.jobs() == []


def test_unreachable_queue_raises_store_unavailable(jobs: QueueFixture, tmp_path):
    lost = Refinements(f"sqlite:///{tmp_path}/no/such/folder/state.db", jobs.store)
    with pytest.raises(StoreUnavailable):
        lost.start("arm3", None, {}, "me")


def test_job_whose_server_died_before_queueing_it_is_adopted(jobs: QueueFixture, fixture: JobFixture):
    fixture.add_job("lost")
    jobs.now_s = 5.0
    assert jobs.reaper.adopt() == []
    jobs.now_s = 20.0
    assert jobs.reaper.adopt() == ["lost"]
    assert jobs.statuses() == {"lost": "ENQUEUED"}
    assert jobs.reaper.adopt() == []


def test_job_that_failed_while_the_store_was_away_is_marked(jobs: QueueFixture):
    job = jobs.queue.start("arm3", None, {}, "me")
    jobs.client.cancel_workflow(job.id)
    assert jobs.reaper.adopt() == [job.id]
    assert jobs.queue.job(job.id).state == "failed"


def test_job_that_the_queue_dropped_is_queued_again(jobs: QueueFixture, fixture: JobFixture):
    job = jobs.queue.start("arm3", None, {}, "me")
    with closing(sqlite3.connect(fixture.folder / "jobs.db")) as database:  # taken by this worker, and not started
        database.execute("UPDATE workflow_status SET status = 'PENDING', executor_id = 'me'")
        database.commit()
    assert jobs.reaper.requeue_dropped() == []  # it may be about to start
    jobs.running.add(job.id)
    assert jobs.reaper.requeue_dropped() == []
    jobs.running.clear()
    assert jobs.reaper.requeue_dropped() == []
    assert jobs.statuses() == {job.id: "PENDING"}
    assert jobs.reaper.requeue_dropped() == [job.id]
    assert jobs.statuses() == {job.id: "ENQUEUED"}
    assert jobs.reaper.requeue_dropped() == []
    assert jobs.queue.job(job.id).reaps == 0


def test_steps_of_old_jobs_are_removed(jobs: QueueFixture):
    job = jobs.queue.start("arm3", None, {}, "me")
    jobs.queue.cancel(job.id, author="me")
    jobs.now_s = 0.0 + KEPT_S
    assert jobs.reaper.remove_old() == 0
    jobs.now_s = 4e9
    assert jobs.reaper.remove_old() == 1
    assert jobs.statuses() == {}
    assert jobs.queue.job(job.id).state == "cancelled"


def test_postgresql_keeps_jobs_in_its_own_database():
    url = "postgresql+psycopg://someone:secret@host:5432/adverb"
    assert dbos_setup.system_url(url) == "postgresql://someone:secret@host:5432/adverb"
    assert dbos_setup.system_url("sqlite:////data/state.db") == "sqlite:////data/jobs.db"
