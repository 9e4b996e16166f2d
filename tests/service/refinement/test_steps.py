"""What the steps of a job come to; queue and processes do not matter here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.refinement.job_spec import Asked
from service.refinement.usage_counts import cells_of, drawn
from service.refinement.worker import steps as steps_module
from service.refinement.worker.steps import Leaving, Work, transient
from service.store.records import StoreUnavailable
from tests.service.refinement.conftest import Bench
from verbs import library
from verbs.errors import OutOfRange, UnknownName
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.runtime.evaluate import Evaluator


def traffic(verb, rng, count):
    """Adverbs (count, D) about one place of the domain."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    around = low + (high - low) * (0.7 + 0.06 * rng.normal(size=(count, 2)))
    return drawn(verb, cells_of(verb, around)["cells"], rng, count)


def offline(**rules):
    verb, rules = library.load("arm3"), Rules(**{"target_error": 0.0, "max_pseudo": 6, **rules})
    steps = list(refine(verb, rules))
    return with_basis(verb, steps[-1].basis, rules, steps[-1].mark), steps


def test_job_publishes_the_bytes_that_refine_gives(bench: Bench):
    bench.publish()
    row = bench.ran("j")
    verb, steps = offline()
    path = bench.folder / "offline.verb"
    artifact.save(verb, path)
    version = bench.store.current()["arm3"]
    assert (row.state, row.version_after) == ("published", 2)
    assert (version.number, version.parent, version.author) == (2, 1, "job j")
    assert bench.store.path(version).read_bytes() == path.read_bytes()
    assert row.progress["curve"] == [[step.pseudo, step.after.mean, step.after.largest] for step in steps]
    assert row.progress["ratio"] == 1.0
    assert row.progress["stopped"] == "most pseudo-examples reached"
    assert not list(bench.folder.glob("verbs/jobs/*"))


def test_same_seed_gives_the_same_bytes_however_steps_are_cut(bench: Bench):
    bench.publish()
    bench.work.step_s = 100.0
    first = bench.ran("a")
    bench.store.activate("arm3", 1, author="test", reason="again")
    bench.work.step_s = 0.0
    second = bench.ran("b")
    assert first.version_after == second.version_after == 2


def test_any_step_can_be_done_twice(bench: Bench):
    bench.publish()

    def twice(name, function, *arguments):
        Bench.step(name, function, *arguments)
        return Bench.step(name, function, *arguments)

    work = Work(bench.store, str(bench.folder / "verbs"), step=twice, step_s=0.0)
    work.run(bench.job("j"))
    row = bench.store.job("j")
    assert (row.state, row.version_after) == ("published", 2)
    assert len(bench.store.versions("arm3")) == 2
    assert [point[0] for point in row.progress["curve"]] == list(range(7))


def test_job_goes_on_where_another_process_left_it(bench: Bench):
    bench.publish()
    done: dict[int, dict] = {}

    def remembered(name, function, *arguments):
        number = len(calls)
        calls.append(name)
        if number not in done:
            if number == 4:
                raise Leaving
            done[number] = Bench.step(name, function, *arguments)
        return done[number]

    work = Work(bench.store, str(bench.folder / "verbs"), step=remembered, step_s=0.0)
    calls: list[str] = []
    with pytest.raises(Leaving):
        work.run(bench.job("j"))
    assert bench.store.job("j").state == "running"
    calls, done[4] = [], Bench.step("advance", work.advance, "j", done[3])
    work.run("j")
    assert bench.store.job("j").state == "published"
    assert bench.store.path(bench.store.current()["arm3"]).stat().st_size > 0


def test_result_that_is_not_better_changes_nothing(bench: Bench):
    bench.publish(offline(max_pseudo=20)[0])
    row = bench.ran("j", max_pseudo=3)
    assert (row.state, row.version_after) == ("not_better", None)
    assert row.detail.startswith(
        "not better: its mean error is not lower, its largest error is not lower; at 3000 held"
    )
    figures = row.progress["figures"]
    assert figures["new"]["error_mean_m"] > figures["now"]["error_mean_m"] > 0.0
    assert figures["now"]["method"] == figures["new"]["method"] == "refined"
    assert bench.store.current()["arm3"].number == 1
    assert not list(bench.folder.glob("verbs/jobs/*"))


def test_result_that_is_less_smooth_is_not_published(bench: Bench, monkeypatch):
    monkeypatch.setattr("service.refinement.worker.acceptance.SMOOTHNESS_LIMIT", 1.0)
    bench.publish()
    row = bench.ran("j")
    assert row.state == "not_better"
    assert row.progress["figures"]["reasons"] == ["its κ is more than 1.0 times the current one's"]


def test_hybrid_is_judged_by_hybrid(bench: Bench):
    bench.publish(offline(max_pseudo=2)[0])
    row = bench.ran("j", method="hybrid", max_pseudo=20)
    assert row.progress["figures"]["now"]["method"] == "hybrid"
    assert row.state == "published"


def test_result_is_not_activated_after_a_roll_back(bench: Bench):
    bench.publish()
    bench.publish(offline(max_pseudo=2)[0])
    job = bench.job("j", max_pseudo=12, version=2)
    bench.store.activate("arm3", 1, author="test", reason="roll back")
    bench.work.run(job)
    row = bench.store.job(job)
    assert (row.state, row.version_after) == ("published", 3)
    assert bench.store.current()["arm3"].number == 1
    assert bench.store.version("arm3", 3).parent == 2
    assert row.detail.startswith("kept as version 3, not activated: version 1 is current")
    assert "started from version 2" in row.detail


def test_result_is_not_activated_over_a_version_that_was_published_meanwhile(bench: Bench):
    bench.publish()
    job, verb = bench.job("j", max_pseudo=12), library.load("arm3")
    bench.publish(replace(verb, curves=np.ascontiguousarray(verb.curves * np.float32(0.99))))
    bench.work.run(job)
    row = bench.store.job(job)
    assert (row.state, row.version_after) == ("published", 3)
    assert (bench.store.current()["arm3"].number, bench.store.version("arm3", 3).parent) == (2, 1)
    assert row.progress["figures"]["against"] == 1


def test_roll_back_between_comparison_and_publication_is_not_undone(bench: Bench):
    bench.publish(offline(max_pseudo=2)[0])
    bench.publish()
    bench.store.activate("arm3", 1, author="test", reason="start here")

    def disturbed(name, function, *arguments):
        if name == "publish":
            bench.store.activate("arm3", 2, author="test", reason="roll forward")
        return Bench.step(name, function, *arguments)

    Work(bench.store, str(bench.folder / "verbs"), step=disturbed, step_s=0.0).run(bench.job("j", max_pseudo=12))
    assert bench.store.job("j").version_after == 3
    assert bench.store.current()["arm3"].number == 2


def test_verb_that_is_deleted_before_publication_ends_a_job(bench: Bench):
    bench.publish()

    def disturbed(name, function, *arguments):
        if name == "publish":
            bench.store.delete("arm3", author="test", reason="test")
        return Bench.step(name, function, *arguments)

    Work(bench.store, str(bench.folder / "verbs"), step=disturbed, step_s=0.0).run(bench.job("j"))
    row = bench.store.job("j")
    assert (row.state, row.version_after) == ("not_better", None)
    assert row.detail == "not better: the verb was deleted meanwhile"
    assert "arm3" not in bench.store.current()


def test_deleted_verb_ends_a_job(bench: Bench):
    bench.publish()
    job = bench.job("j")
    bench.store.delete("arm3", author="test", reason="test")
    bench.work.run(job)
    assert bench.store.job(job).detail == "not better: the verb was deleted meanwhile"


def test_budget_ends_a_refinement(bench: Bench):
    bench.publish()
    row = bench.ran("j", budget_s=1e-6, max_pseudo=500)
    assert row.progress["stopped"] == "budget spent"
    assert row.progress["steps"] == 0
    assert row.state == "not_better"


def test_cancelled_job_takes_no_further_step(bench: Bench):
    bench.publish()
    advanced = []

    def cancelled(name, function, *arguments):
        if name == "advance":
            advanced.append(name)
            if len(advanced) == 2:
                bench.store.update_job("j", state="cancelled", detail="cancelled by me")
        return Bench.step(name, function, *arguments)

    Work(bench.store, str(bench.folder / "verbs"), step=cancelled, step_s=0.0).run(bench.job("j"))
    row = bench.store.job("j")
    assert (row.state, row.detail) == ("cancelled", "cancelled by me")
    assert len(advanced) == 2
    assert row.progress["steps"] == 0
    assert bench.store.current()["arm3"].number == 1


def test_result_of_a_job_that_is_cancelled_at_last_is_not_published(bench: Bench):
    bench.publish()

    def cancelled(name, function, *arguments):
        given = Bench.step(name, function, *arguments)
        if name == "weigh":
            bench.store.update_job("j", state="cancelled", detail="cancelled by me")
        return given

    Work(bench.store, str(bench.folder / "verbs"), step=cancelled, step_s=0.0).run(bench.job("j"))
    assert bench.store.job("j").state == "cancelled"
    assert bench.store.current()["arm3"].number == 1
    assert not list(bench.folder.glob("verbs/jobs/*"))


def test_job_that_is_cancelled_while_it_publishes_publishes_nothing(bench: Bench, monkeypatch):
    bench.publish()
    publish = bench.store.publish

    def late(*arguments, **options):
        def cancel(step: str) -> None:
            if step == "transaction":
                bench.store.update_job("j", state="cancelled", detail="cancelled by me")

        return publish(*arguments, **options, at=cancel)

    monkeypatch.setattr(bench.store, "publish", late)
    row = bench.ran("j")
    assert (row.state, row.version_after, row.detail) == ("cancelled", None, "cancelled by me")
    assert [version.number for version in bench.store.versions("arm3")] == [1]
    assert not list(bench.folder.glob("verbs/jobs/*"))


def test_failure_is_told_to_the_user_and_its_inside_is_not(bench: Bench, monkeypatch):
    bench.publish()

    def broken(*arguments, **options):
        raise ValueError("/secret/place")

    monkeypatch.setattr(steps_module, "go_on", broken)
    row = bench.ran("j")
    assert (row.state, row.detail) == ("failed", "internal error (ValueError); the worker's log has the rest")


def test_failure_of_the_library_is_told_in_its_words(bench: Bench, monkeypatch):
    bench.publish()

    def refused(*arguments, **options):
        raise OutOfRange("that is too much")

    monkeypatch.setattr(steps_module, "go_on", refused)
    assert bench.ran("j").detail == "that is too much"


def test_steps_wait_for_a_store_that_is_away_and_for_nothing_else():
    assert transient(StoreUnavailable("gone"))
    assert not transient(OutOfRange("no"))
    assert not transient(OSError("no"))


def test_traffic_lowers_the_error_where_a_verb_is_asked_for(bench: Bench):
    bench.publish()
    verb = library.load("arm3")
    asked = traffic(verb, np.random.default_rng(5), 4_000)
    bench.store.put_traffic("arm3", "server", cells_of(verb, asked), 2e9)
    uniform = bench.ran("uniform", max_pseudo=16)
    bench.store.activate("arm3", 1, author="test", reason="compare")
    weighted = bench.ran("weighted", max_pseudo=16, weighted_by_traffic=True)
    assert weighted.progress["pseudo"] == uniform.progress["pseudo"] == 16
    assert weighted.progress["curve_traffic"][-1][1] < uniform.progress["curve"][-1][1]
    fresh, errors = traffic(verb, np.random.default_rng(6), 2_000), []
    for row in (uniform, weighted):
        published = artifact.load(bench.store.path(bench.store.version("arm3", row.version_after)))
        errors.append(Evaluator(published).blend(fresh, method="refined").error.mean())
    assert errors[1] < 0.8 * errors[0]
    assert published.provenance["refinement"]["weighted_by_traffic"]


def test_job_says_where_there_was_no_traffic(bench: Bench):
    bench.publish()
    row = bench.ran("j", weighted_by_traffic=True)
    assert row.progress["note"] == "no traffic was recorded"
    assert row.progress["curve_traffic"] == []
    assert row.state == "published"


@pytest.mark.parametrize(
    ("values", "error", "match"),
    [
        ({"method": "rbf"}, UnknownName, "refined, hybrid"),
        ({"budget_s": 0.0}, OutOfRange, "budget_s is 0.0"),
        ({"budget_s": float("nan")}, OutOfRange, "budget_s is nan"),
        ({"priority": 0}, OutOfRange, "between 1 and 100"),
        ({"target_error": -1.0}, OutOfRange, "target_error"),
        ({"max_pseudo": 10**6}, OutOfRange, "max_pseudo"),
        ({"colour": "red"}, UnknownName, "colour"),
        ({"max_pseudo": "many"}, OutOfRange, "max_pseudo is 'many'; it must be of the type int"),
        ({"max_pseudo": True}, OutOfRange, "max_pseudo is True"),
        ({"weighted_by_traffic": 1}, OutOfRange, "of the type bool"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(values, error, match):
    with pytest.raises(error, match=match):
        Asked.of(values)
