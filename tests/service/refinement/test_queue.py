"""What servers do with jobs, and what a reaper makes of what they leave; no worker runs here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from service.refinement import engine
from service.refinement.errors import AlreadyRunning
from service.refinement.queue import Refinements
from service.refinement.worker.locks import locks_of
from service.refinement.worker.reaper import KEPT_S, Reaper
from service.store.records import ENDED, Job, StoreUnavailable, UnknownJob, UnknownVerb, UnknownVersion
from service.store.store import Store
from tests.service.refinement.conftest import Bench
from verbs.errors import OutOfRange


@dataclass
class Desk:
    store: Store
    queue: Refinements
    client: object
    reaper: Reaper
    now_s: float

    def statuses(self) -> dict[str, str]:
        return {row.workflow_id: row.status for row in self.client.list_workflows(name=engine.WORKFLOW)}


@pytest.fixture
def desk(bench: Bench) -> Iterator[Desk]:
    bench.publish()
    url = f"sqlite:///{bench.folder}/state.db"
    engine.prepare(url)
    client, locks = engine.connect(url), locks_of(url)
    artifacts = str(bench.folder / "verbs")
    reaper = Reaper(bench.store, client, locks, "me", artifacts=artifacts, clock=lambda: found.now_s)
    found = Desk(bench.store, Refinements(url, bench.store), client, reaper, 1e10)
    yield found
    found.queue.close()
    client.destroy()


def test_job_is_queued_once_to_a_verb(desk: Desk):
    job = desk.queue.start("arm3", None, {"priority": 3}, "me")
    assert (job.state, job.version_before, job.request["author"], job.request["priority"]) == ("queued", 1, "me", 3)
    assert desk.queue.job(job.id) == job
    assert desk.queue.jobs(verb="arm3") == [job]
    with pytest.raises(AlreadyRunning) as caught:
        desk.queue.start("arm3", 1, {}, "me")
    assert caught.value.job == job.id
    forced = desk.queue.start("arm3", 1, {}, "me", force=True)
    assert desk.statuses() == {job.id: "ENQUEUED", forced.id: "ENQUEUED"}


def test_of_two_that_start_at_once_one_is_told(desk: Desk, monkeypatch):
    first = desk.queue.start("arm3", None, {}, "me")
    refuse = desk.queue._refuse_second
    monkeypatch.setattr(desk.queue, "_refuse_second", lambda verb, mine=None: refuse(verb, mine) if mine else None)
    with pytest.raises(AlreadyRunning):
        desk.queue.start("arm3", None, {}, "me")
    assert sorted(job.state for job in desk.queue.jobs()) == ["cancelled", "queued"]
    assert list(desk.statuses()) == [first.id]


def test_cancelled_job_leaves_the_queue_and_the_verb_is_free(desk: Desk):
    job = desk.queue.start("arm3", None, {}, "me")
    assert desk.queue.cancel(job.id, author="you").detail == "cancelled by you"
    assert desk.statuses() == {job.id: "CANCELLED"}
    assert desk.queue.cancel(job.id, author="me").detail == "cancelled by you"
    desk.queue.start("arm3", None, {}, "me")


def test_job_that_publishes_while_it_is_being_cancelled_stays_published(desk: Desk, monkeypatch):
    job, read = desk.queue.start("arm3", None, {}, "me"), desk.store.job

    def read_before_the_last_step(id: str) -> Job:
        found = read(id)
        if found.state not in ENDED:
            desk.store.update_job(id, state="published", version_after=2, detail="better")
        return found

    monkeypatch.setattr(desk.store, "job", read_before_the_last_step)
    found = desk.queue.cancel(job.id)
    assert (found.state, found.version_after, found.detail) == ("published", 2, "better")


def test_what_does_not_exist_cannot_be_refined(desk: Desk):
    with pytest.raises(UnknownVerb):
        desk.queue.start("nothing", None, {}, "me")
    with pytest.raises(UnknownVersion):
        desk.queue.start("arm3", 7, {}, "me")
    with pytest.raises(OutOfRange):
        desk.queue.start("arm3", None, {"max_pseudo": -1}, "me")
    with pytest.raises(UnknownJob):
        desk.queue.cancel("nothing")
    assert desk.queue.jobs() == []


def test_queue_that_cannot_be_reached_is_the_store_being_unavailable(desk: Desk, tmp_path):
    lost = Refinements(f"sqlite:///{tmp_path}/no/such/folder/state.db", desk.store)
    with pytest.raises(StoreUnavailable):
        lost.start("arm3", None, {}, "me")


def test_job_whose_server_died_before_queueing_it_is_adopted(desk: Desk, bench: Bench):
    bench.job("lost")
    desk.now_s = 5.0
    assert desk.reaper.adopt() == []
    desk.now_s = 20.0
    assert desk.reaper.adopt() == ["lost"]
    assert desk.statuses() == {"lost": "ENQUEUED"}
    assert desk.reaper.adopt() == []


def test_job_that_failed_untold_is_told(desk: Desk):
    job = desk.queue.start("arm3", None, {}, "me")
    desk.client.cancel_workflow(job.id)
    assert desk.reaper.adopt() == [job.id]
    assert desk.queue.job(job.id).state == "failed"


def test_steps_of_old_jobs_are_forgotten(desk: Desk):
    job = desk.queue.start("arm3", None, {}, "me")
    desk.queue.cancel(job.id)
    desk.now_s = 0.0 + KEPT_S
    assert desk.reaper.tidy() == 0
    desk.now_s = 4e9
    assert desk.reaper.tidy() == 1
    assert desk.statuses() == {}
    assert desk.queue.job(job.id).state == "cancelled"


def test_postgresql_keeps_jobs_in_its_own_database():
    url = "postgresql+psycopg://someone:secret@host:5432/adverb"
    assert engine.system_url(url) == "postgresql://someone:secret@host:5432/adverb"
    assert engine.system_url("sqlite:////data/state.db") == "sqlite:////data/jobs.db"
