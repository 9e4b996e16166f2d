"""What a server does beside answering: traffic is told, refinements are counted and started, old things are removed."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import COLLECT_S, LEAST_ANSWERS, REST_S, TELL_S, WHO, Watch
from service.refinement.usage import Demand
from service.store.records import Job, StoreUnavailable
from service.store.store import ORPHAN_S, Store
from verbs import library
from verbs.goal import diagonal

NOW_S = 2e9
DAY_S = 86_400.0


class Watched:
    """A store with arm3 in it, and what watches it."""

    def __init__(self, folder, **options):
        self.url = f"sqlite:///{folder}/state.db"
        self.now_s = NOW_S
        self.store = Store.open(self.url, str(folder / "verbs"), timeout_s=0.3, clock=lambda: self.now_s)
        self.uploads = folder / "uploads"
        self.uploads.mkdir()
        self.refinements = Refinements(self.url, self.store)
        self.demand, self.metrics = Demand(), Metrics()
        path = Path(library.__file__).with_name("arm3.verb")
        self.store.publish("arm3", path, author="test", reason="test", quality={})
        self.watch = Watch(
            *(self.store, self.refinements, self.demand, self.metrics),
            **{"refine_above": None, **options},
            uploads=self.uploads,
            started_s=self.now_s,
        )

    def look(self, *, later_s=0.0):
        self.now_s += later_s
        self.watch.look(self.demand.take(), self.now_s)

    def ask(self, entry, count, error=0.0):
        """Answers whose error is a share of the diagonal."""
        rows = np.repeat(entry.verb.values[:1], count, axis=0)
        self.demand.ask(entry, rows, np.full(count, error * diagonal(entry.verb)), rows=count)

    def traffic(self):
        return self.store.traffic("arm3", not_before_s=0.0)

    def samples(self):
        return {
            (sample.name, *sorted(sample.labels.values())): sample.value
            for family in text_string_to_metric_families(self.metrics.text().decode())
            for sample in family.samples
            if "refinement" in sample.name
        }


@pytest.fixture
def watched(tmp_path):
    made = []

    def make(**options):
        made.append(Watched(tmp_path, **options))
        return made[-1]

    yield make
    for one in made:
        one.refinements.close()
        one.store.close()


@pytest.fixture
def arm(catalog):
    return catalog.entries["arm3"]


def test_what_was_asked_is_told_every_few_seconds(watched, arm):
    one = watched()
    one.ask(arm, 7)
    one.look()
    (row,) = one.traffic()
    assert (row["at_s"], [cell["weight"] for cell in row["cells"]]) == (NOW_S, [7.0])
    one.ask(arm, 3)
    one.look(later_s=TELL_S / 2)
    assert one.traffic() == [row]
    one.look(later_s=TELL_S / 2)
    (row,) = one.traffic()
    assert row["cells"][0]["weight"] == pytest.approx(10.0, abs=1e-2)
    one.look(later_s=TELL_S)
    assert one.traffic() == [row]  # nobody asked meanwhile, and nothing was written


def test_two_servers_add_up(watched, arm, tmp_path):
    one = watched()
    other = Watch(
        *(one.store, one.refinements, Demand(), one.metrics),
        refine_above=None,
        uploads=one.uploads,
        started_s=NOW_S,
    )
    one.ask(arm, 5)
    noted = one.demand.take()
    for watch in (one.watch, other):
        watch.look(noted, NOW_S)
    assert [row["cells"][0]["weight"] for row in one.traffic()] == [5.0, 5.0]


def test_a_store_that_is_away_is_told_later(watched, arm):
    one = watched()
    one.ask(arm, 7)
    with closing(sqlite3.connect(one.url.removeprefix("sqlite:///"), isolation_level=None)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreUnavailable):
            one.look()
        connection.execute("ROLLBACK")
    one.ask(arm, 2)
    one.look(later_s=1.0)
    assert one.traffic()[0]["cells"][0]["weight"] == pytest.approx(9.0, abs=1e-2)


def test_far_answers_start_one_refinement_and_then_there_is_rest(watched, arm):
    one = watched(refine_above=0.01)
    one.ask(arm, LEAST_ANSWERS, 0.02)
    one.look()
    (job,) = one.store.jobs()
    asked = {name: job.request[name] for name in ("author", "weighted_by_traffic", "priority")}
    assert (job.verb, job.state, job.version_before) == ("arm3", "queued", 1)
    assert asked == {"author": WHO, "weighted_by_traffic": True, "priority": 100}
    one.ask(arm, LEAST_ANSWERS, 0.02)
    one.look(later_s=REST_S)
    assert one.store.jobs() == [job]
    one.store.update_job(job.id, state="not_better", detail="not better")
    for later_s in (1.0, REST_S - 2.0):
        one.ask(arm, 10 * LEAST_ANSWERS, 0.02)
        one.look(later_s=later_s)
    assert len(one.store.jobs()) == 1
    one.ask(arm, LEAST_ANSWERS, 0.02)
    one.look(later_s=2.0)
    assert [row.state for row in one.store.jobs()] == ["queued", "not_better"]


@pytest.mark.parametrize(
    ("above", "count", "error"),
    [(None, 500, 0.5), (0.01, 500, 0.009), (0.01, LEAST_ANSWERS - 1, 0.5)],
    ids=["off", "near enough", "too few"],
)
def test_nothing_is_refined_without_reason(watched, arm, above, count, error):
    one = watched(refine_above=above)
    one.ask(arm, count, error)
    one.look()
    assert one.store.jobs() == []


def test_a_verb_that_is_deleted_or_refined_already_is_left_alone(watched, arm):
    one = watched(refine_above=0.01)
    mine = one.refinements.start("arm3", None, {}, "me")
    one.ask(arm, LEAST_ANSWERS, 0.5)
    one.look()
    assert one.store.jobs() == [mine]
    one.refinements.cancel(mine.id)
    one.store.delete("arm3", author="me", reason="test")
    one.look(later_s=REST_S)
    assert len(one.store.jobs()) == 1


def test_metrics_tell_what_ended_and_how_far_the_others_are(watched):
    one = watched()
    states = ["published", "not_better", "not_better", "running", "queued"]
    for k, state in enumerate(states):
        progress = {"ratio": 0.25} if state == "running" else {}
        one.store.add_job(Job(f"j{k}", "arm3", state, {}, progress, 0, 1, None, "", NOW_S, NOW_S))
    one.look()
    assert one.samples() == {
        ("adverb_refinements_total", "arm3", "published"): 1,
        ("adverb_refinements_total", "arm3", "not_better"): 2,
        ("adverb_refinement_progress_ratio", "arm3"): 0.25,
    }
    one.store.update_job("j3", state="failed")
    one.look()
    assert one.samples()["adverb_refinements_total", "arm3", "failed"] == 1
    assert ("adverb_refinement_progress_ratio", "arm3") not in one.samples()


def test_what_nobody_needs_is_collected_now_and_then(watched, tmp_path):
    one = watched()
    artifact = tmp_path / "artifact"
    for k in range(7):
        artifact.write_text(f"version {k}")
        one.store.publish("arm3", artifact, author="test", reason="test", quality={})
    left, fresh = one.uploads / "left.upload", one.uploads / "fresh.upload"
    for file, age_s in ((left, ORPHAN_S + 60.0), (fresh, 0.0)):
        file.touch()
        at_s = NOW_S + 30 * DAY_S - age_s
        os.utime(file, (at_s, at_s))
    one.look(later_s=COLLECT_S[0] - 1.0)
    assert len(one.store.versions("arm3")) == 8
    one.look(later_s=30 * DAY_S - COLLECT_S[0] + 1.0)
    assert [version.number for version in one.store.versions("arm3")] == [4, 5, 6, 7, 8]
    assert (left.exists(), fresh.exists()) == (False, True)
    one.store.publish("arm3", Path(library.__file__).with_name("board.verb"), author="test", reason="test", quality={})
    one.look(later_s=COLLECT_S[1] - 1.0)
    assert len(one.store.versions("arm3")) == 6
    one.look(later_s=8 * DAY_S)
    assert len(one.store.versions("arm3")) == 5
