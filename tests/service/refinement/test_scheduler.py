"""Scheduled tasks: usage is stored, refinements are counted and started, old files are removed."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import AUTHOR, COLLECT_S, MIN_ANSWERS, REST_S, STORE_USAGE_S, Scheduler
from service.refinement.usage import Usage
from service.store.records import Job, StoreUnavailable
from service.store.store import ORPHAN_S, Store
from verbs import library
from verbs.goal import diagonal

NOW_S = 2e9
DAY_S = 86_400.0


class SchedulerFixture:
    """A store with arm3, and its scheduler."""

    def __init__(self, folder, **options):
        self.url = f"sqlite:///{folder}/state.db"
        self.now_s = NOW_S
        self.store = Store.open(self.url, str(folder / "verbs"), timeout_s=0.3, clock=lambda: self.now_s)
        self.uploads = folder / "uploads"
        self.uploads.mkdir()
        self.refinements = Refinements(self.url, self.store)
        self.usage, self.metrics = Usage(), Metrics()
        path = Path(library.__file__).with_name("arm3.verb")
        self.store.publish("arm3", path, author="test", reason="test", quality={})
        self.scheduler = Scheduler(
            *(self.store, self.refinements, self.usage, self.metrics),
            **{"refine_above": None, **options},
            uploads=self.uploads,
            started_s=self.now_s,
        )

    def run_once(self, *, later_s=0.0):
        self.now_s += later_s
        self.scheduler.run_once(self.usage.take(), self.now_s)

    def record(self, entry, count, error=0.0):
        """Record poses whose error is a share of the diagonal."""
        rows = np.repeat(entry.verb.values[:1], count, axis=0)
        self.usage.record(entry, rows, np.full(count, error * diagonal(entry.verb)), rows=count)

    def stored_usage(self):
        return self.store.usage("arm3", not_before_s=0.0)

    def samples(self):
        return {
            (sample.name, *sorted(sample.labels.values())): sample.value
            for family in text_string_to_metric_families(self.metrics.text().decode())
            for sample in family.samples
            if "refinement" in sample.name
        }


@pytest.fixture
def make_fixture(tmp_path):
    made = []

    def make(**options):
        made.append(SchedulerFixture(tmp_path, **options))
        return made[-1]

    yield make
    for fixture in made:
        fixture.refinements.close()
        fixture.store.close()


@pytest.fixture
def arm(catalog):
    return catalog.entries["arm3"]


def test_usage_is_stored_every_few_seconds(make_fixture, arm):
    fixture = make_fixture()
    fixture.record(arm, 7)
    fixture.run_once()
    (row,) = fixture.stored_usage()
    assert (row["at_s"], [cell["weight"] for cell in row["cells"]]) == (NOW_S, [7.0])
    fixture.record(arm, 3)
    fixture.run_once(later_s=STORE_USAGE_S / 2)
    assert fixture.stored_usage() == [row]
    fixture.run_once(later_s=STORE_USAGE_S / 2)
    (row,) = fixture.stored_usage()
    assert row["cells"][0]["weight"] == pytest.approx(10.0, abs=1e-2)
    fixture.run_once(later_s=STORE_USAGE_S)
    assert fixture.stored_usage() == [row]  # no requests meanwhile, so nothing was written


def test_usage_of_two_servers_adds_up(make_fixture, arm, tmp_path):
    fixture = make_fixture()
    other = Scheduler(
        *(fixture.store, fixture.refinements, Usage(), fixture.metrics),
        refine_above=None,
        uploads=fixture.uploads,
        started_s=NOW_S,
    )
    fixture.record(arm, 5)
    records = fixture.usage.take()
    for scheduler in (fixture.scheduler, other):
        scheduler.run_once(records, NOW_S)
    assert [row["cells"][0]["weight"] for row in fixture.stored_usage()] == [5.0, 5.0]


def test_usage_is_stored_when_the_store_is_back(make_fixture, arm):
    fixture = make_fixture()
    fixture.record(arm, 7)
    with closing(sqlite3.connect(fixture.url.removeprefix("sqlite:///"), isolation_level=None)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreUnavailable):
            fixture.run_once()
        connection.execute("ROLLBACK")
    fixture.record(arm, 2)
    fixture.run_once(later_s=1.0)
    assert fixture.stored_usage()[0]["cells"][0]["weight"] == pytest.approx(9.0, abs=1e-2)


def test_large_errors_start_one_refinement_followed_by_a_rest(make_fixture, arm):
    fixture = make_fixture(refine_above=0.01)
    fixture.record(arm, MIN_ANSWERS, 0.02)
    fixture.run_once()
    (job,) = fixture.store.jobs()
    requested = {name: job.request[name] for name in ("author", "weighted_by_traffic", "priority")}
    assert (job.verb, job.state, job.version_before) == ("arm3", "queued", 1)
    assert requested == {"author": AUTHOR, "weighted_by_traffic": True, "priority": 100}
    fixture.record(arm, MIN_ANSWERS, 0.02)
    fixture.run_once(later_s=REST_S)
    assert fixture.store.jobs() == [job]
    fixture.store.update_job(job.id, state="not_better", detail="not better")
    for later_s in (1.0, REST_S - 2.0):
        fixture.record(arm, 10 * MIN_ANSWERS, 0.02)
        fixture.run_once(later_s=later_s)
    assert len(fixture.store.jobs()) == 1
    fixture.record(arm, MIN_ANSWERS, 0.02)
    fixture.run_once(later_s=2.0)
    assert [row.state for row in fixture.store.jobs()] == ["queued", "not_better"]


@pytest.mark.parametrize(
    ("above", "count", "error"),
    [(None, 500, 0.5), (0.01, 500, 0.009), (0.01, MIN_ANSWERS - 1, 0.5)],
    ids=["off", "near enough", "too few"],
)
def test_small_or_few_errors_start_no_refinement(make_fixture, arm, above, count, error):
    fixture = make_fixture(refine_above=above)
    fixture.record(arm, count, error)
    fixture.run_once()
    assert fixture.store.jobs() == []


def test_a_deleted_or_already_refined_verb_is_not_refined(make_fixture, arm):
    fixture = make_fixture(refine_above=0.01)
    mine = fixture.refinements.start("arm3", None, {}, "me")
    fixture.record(arm, MIN_ANSWERS, 0.5)
    fixture.run_once()
    assert fixture.store.jobs() == [mine]
    fixture.refinements.cancel(mine.id, author="me")
    fixture.store.delete("arm3", author="me", reason="test")
    fixture.run_once(later_s=REST_S)
    assert len(fixture.store.jobs()) == 1


def test_metrics_show_ended_and_running_refinements(make_fixture):
    fixture = make_fixture()
    states = ["published", "not_better", "not_better", "running", "queued"]
    for k, state in enumerate(states):
        progress = {"ratio": 0.25} if state == "running" else {}
        fixture.store.add_job(Job(f"j{k}", "arm3", state, {}, progress, 0, 1, None, "", NOW_S, NOW_S))
    fixture.run_once()
    assert fixture.samples() == {
        ("adverb_refinements_total", "arm3", "published"): 1,
        ("adverb_refinements_total", "arm3", "not_better"): 2,
        ("adverb_refinement_progress_ratio", "arm3"): 0.25,
    }
    fixture.store.update_job("j3", state="failed")
    fixture.run_once()
    assert fixture.samples()["adverb_refinements_total", "arm3", "failed"] == 1
    assert ("adverb_refinement_progress_ratio", "arm3") not in fixture.samples()


def test_old_versions_and_uploads_are_collected(make_fixture, tmp_path):
    fixture = make_fixture()
    artifact = tmp_path / "artifact"
    for k in range(7):
        artifact.write_text(f"version {k}")
        fixture.store.publish("arm3", artifact, author="test", reason="test", quality={})
    left, fresh = fixture.uploads / "left.upload", fixture.uploads / "fresh.upload"
    for file, age_s in ((left, ORPHAN_S + 60.0), (fresh, 0.0)):
        file.touch()
        at_s = NOW_S + 30 * DAY_S - age_s
        os.utime(file, (at_s, at_s))
    fixture.run_once(later_s=COLLECT_S[0] - 1.0)
    assert len(fixture.store.versions("arm3")) == 8
    fixture.run_once(later_s=30 * DAY_S - COLLECT_S[0] + 1.0)
    assert [version.number for version in fixture.store.versions("arm3")] == [4, 5, 6, 7, 8]
    assert (left.exists(), fresh.exists()) == (False, True)
    fixture.store.publish(
        "arm3", Path(library.__file__).with_name("board.verb"), author="test", reason="test", quality={}
    )
    fixture.run_once(later_s=COLLECT_S[1] - 1.0)
    assert len(fixture.store.versions("arm3")) == 6
    fixture.run_once(later_s=8 * DAY_S)
    assert len(fixture.store.versions("arm3")) == 5
