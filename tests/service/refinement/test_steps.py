"""Steps of a refinement job, without queue and processes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.refinement.job_spec import RefinementSpec
from service.refinement.usage_cells import cells_json, sample_cells
from service.refinement.worker import steps as steps_module
from service.refinement.worker.steps import JobSteps, WorkerStopping, transient
from service.store.records import StoreUnavailable
from tests.service.refinement.conftest import JobFixture
from verbs import library
from verbs.errors import OutOfRange, UnknownName
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.runtime.evaluate import Evaluator


def clustered(verb, rng, count):
    """Adverbs (count, D) around one point of the domain."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    around = low + (high - low) * (0.7 + 0.06 * rng.normal(size=(count, 2)))
    return sample_cells(verb, cells_json(verb, around)["cells"], rng, count)


def offline(**rules):
    verb, rules = library.load("arm3"), Rules(**{"target_error": 0.0, "max_pseudo": 6, **rules})
    steps = list(refine(verb, rules))
    return with_basis(verb, steps[-1].basis, rules, steps[-1].mark), steps


def test_job_publishes_the_bytes_that_refine_gives(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j")
    verb, steps = offline()
    path = fixture.folder / "offline.verb"
    artifact.save(verb, path)
    version = fixture.store.current()["arm3"]
    assert (row.state, row.version_after) == ("published", 2)
    assert (version.number, version.parent, version.author) == (2, 1, "job j")
    assert fixture.store.path(version).read_bytes() == path.read_bytes()
    assert row.progress["curve"] == [[step.pseudo, step.after.mean, step.after.largest] for step in steps]
    assert row.progress["ratio"] == 1.0
    assert row.progress["stopped"] == "most pseudo-examples reached"
    assert not list(fixture.folder.glob("verbs/jobs/*"))


def test_same_seed_gives_the_same_bytes_however_steps_are_cut(fixture: JobFixture):
    fixture.publish()
    fixture.steps.step_s = 100.0
    first = fixture.run_job("a")
    fixture.store.activate("arm3", 1, author="test", reason="again")
    fixture.steps.step_s = 0.0
    second = fixture.run_job("b")
    assert first.version_after == second.version_after == 2


def test_any_step_can_be_done_twice(fixture: JobFixture):
    fixture.publish()

    def twice(name, function, *arguments):
        JobFixture.step(name, function, *arguments)
        return JobFixture.step(name, function, *arguments)

    steps = JobSteps(fixture.store, str(fixture.folder / "verbs"), step=twice, step_s=0.0)
    steps.run(fixture.add_job("j"))
    row = fixture.store.job("j")
    assert (row.state, row.version_after) == ("published", 2)
    assert len(fixture.store.versions("arm3")) == 2
    assert [point[0] for point in row.progress["curve"]] == list(range(7))


def test_job_resumes_where_another_process_stopped(fixture: JobFixture):
    fixture.publish()
    done: dict[int, dict] = {}

    def remembered(name, function, *arguments):
        number = len(calls)
        calls.append(name)
        if number not in done:
            if number == 4:
                raise WorkerStopping
            done[number] = JobFixture.step(name, function, *arguments)
        return done[number]

    steps = JobSteps(fixture.store, str(fixture.folder / "verbs"), step=remembered, step_s=0.0)
    calls: list[str] = []
    with pytest.raises(WorkerStopping):
        steps.run(fixture.add_job("j"))
    assert fixture.store.job("j").state == "running"
    calls, done[4] = [], JobFixture.step("advance", steps.advance, "j", done[3])
    steps.run("j")
    assert fixture.store.job("j").state == "published"
    assert fixture.store.path(fixture.store.current()["arm3"]).stat().st_size > 0


def test_result_that_is_not_better_changes_nothing(fixture: JobFixture):
    fixture.publish(offline(max_pseudo=20)[0])
    row = fixture.run_job("j", max_pseudo=3)
    assert (row.state, row.version_after) == ("not_better", None)
    assert row.detail.startswith(
        "not better: its mean error is not lower, its largest error is not lower; at 3000 held"
    )
    figures = row.progress["figures"]
    assert figures["new"]["error_mean_m"] > figures["now"]["error_mean_m"] > 0.0
    assert figures["now"]["method"] == figures["new"]["method"] == "refined"
    assert fixture.store.current()["arm3"].number == 1
    assert not list(fixture.folder.glob("verbs/jobs/*"))


def test_result_that_is_less_smooth_is_not_published(fixture: JobFixture, monkeypatch):
    monkeypatch.setattr("service.refinement.worker.acceptance.SMOOTHNESS_LIMIT", 1.0)
    fixture.publish()
    row = fixture.run_job("j")
    assert row.state == "not_better"
    assert row.progress["figures"]["reasons"] == ["its κ is more than 1.0 times the current one's"]


def test_hybrid_is_compared_by_hybrid(fixture: JobFixture):
    fixture.publish(offline(max_pseudo=2)[0])
    row = fixture.run_job("j", method="hybrid", max_pseudo=20)
    assert row.progress["figures"]["now"]["method"] == "hybrid"
    assert row.state == "published"


def test_result_is_not_activated_after_a_roll_back(fixture: JobFixture):
    fixture.publish()
    fixture.publish(offline(max_pseudo=2)[0])
    job = fixture.add_job("j", max_pseudo=12, version=2)
    fixture.store.activate("arm3", 1, author="test", reason="roll back")
    fixture.steps.run(job)
    row = fixture.store.job(job)
    assert (row.state, row.version_after) == ("published", 3)
    assert fixture.store.current()["arm3"].number == 1
    assert fixture.store.version("arm3", 3).parent == 2
    assert row.detail.startswith("kept as version 3, not activated: version 1 is current")
    assert "started from version 2" in row.detail


def test_result_is_not_activated_over_a_version_that_was_published_meanwhile(fixture: JobFixture):
    fixture.publish()
    job, verb = fixture.add_job("j", max_pseudo=12), library.load("arm3")
    fixture.publish(replace(verb, curves=np.ascontiguousarray(verb.curves * np.float32(0.99))))
    fixture.steps.run(job)
    row = fixture.store.job(job)
    assert (row.state, row.version_after) == ("published", 3)
    assert (fixture.store.current()["arm3"].number, fixture.store.version("arm3", 3).parent) == (2, 1)
    assert row.progress["figures"]["against"] == 1


def test_roll_back_between_comparison_and_publication_is_not_undone(fixture: JobFixture):
    fixture.publish(offline(max_pseudo=2)[0])
    fixture.publish()
    fixture.store.activate("arm3", 1, author="test", reason="start here")

    def disturbed(name, function, *arguments):
        if name == "publish":
            fixture.store.activate("arm3", 2, author="test", reason="roll forward")
        return JobFixture.step(name, function, *arguments)

    JobSteps(fixture.store, str(fixture.folder / "verbs"), step=disturbed, step_s=0.0).run(
        fixture.add_job("j", max_pseudo=12)
    )
    assert fixture.store.job("j").version_after == 3
    assert fixture.store.current()["arm3"].number == 2


def test_verb_that_is_deleted_before_publication_ends_a_job(fixture: JobFixture):
    fixture.publish()

    def disturbed(name, function, *arguments):
        if name == "publish":
            fixture.store.delete("arm3", author="test", reason="test")
        return JobFixture.step(name, function, *arguments)

    JobSteps(fixture.store, str(fixture.folder / "verbs"), step=disturbed, step_s=0.0).run(fixture.add_job("j"))
    row = fixture.store.job("j")
    assert (row.state, row.version_after) == ("not_better", None)
    assert row.detail == "not better: the verb was deleted meanwhile"
    assert "arm3" not in fixture.store.current()


def test_deleted_verb_ends_a_job(fixture: JobFixture):
    fixture.publish()
    job = fixture.add_job("j")
    fixture.store.delete("arm3", author="test", reason="test")
    fixture.steps.run(job)
    assert fixture.store.job(job).detail == "not better: the verb was deleted meanwhile"


def test_budget_ends_a_refinement(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", budget_s=1e-6, max_pseudo=500)
    assert row.progress["stopped"] == "budget spent"
    assert row.progress["steps"] == 0
    assert row.state == "not_better"


def test_cancelled_job_takes_no_further_step(fixture: JobFixture):
    fixture.publish()
    advanced = []

    def cancelled(name, function, *arguments):
        if name == "advance":
            advanced.append(name)
            if len(advanced) == 2:
                fixture.store.update_job("j", state="cancelled", detail="cancelled by me")
        return JobFixture.step(name, function, *arguments)

    JobSteps(fixture.store, str(fixture.folder / "verbs"), step=cancelled, step_s=0.0).run(fixture.add_job("j"))
    row = fixture.store.job("j")
    assert (row.state, row.detail) == ("cancelled", "cancelled by me")
    assert len(advanced) == 2
    assert row.progress["steps"] == 0
    assert fixture.store.current()["arm3"].number == 1


def test_result_of_a_job_that_is_cancelled_before_publication_is_not_published(fixture: JobFixture):
    fixture.publish()

    def cancelled(name, function, *arguments):
        given = JobFixture.step(name, function, *arguments)
        if name == "compare":
            fixture.store.update_job("j", state="cancelled", detail="cancelled by me")
        return given

    JobSteps(fixture.store, str(fixture.folder / "verbs"), step=cancelled, step_s=0.0).run(fixture.add_job("j"))
    assert fixture.store.job("j").state == "cancelled"
    assert fixture.store.current()["arm3"].number == 1
    assert not list(fixture.folder.glob("verbs/jobs/*"))


def test_job_that_is_cancelled_while_it_publishes_publishes_nothing(fixture: JobFixture, monkeypatch):
    fixture.publish()
    publish = fixture.store.publish

    def late(*arguments, **options):
        def cancel(step: str) -> None:
            if step == "transaction":
                fixture.store.update_job("j", state="cancelled", detail="cancelled by me")

        return publish(*arguments, **options, at=cancel)

    monkeypatch.setattr(fixture.store, "publish", late)
    row = fixture.run_job("j")
    assert (row.state, row.version_after, row.detail) == ("cancelled", None, "cancelled by me")
    assert [version.number for version in fixture.store.versions("arm3")] == [1]
    assert not list(fixture.folder.glob("verbs/jobs/*"))


def test_detail_of_a_failure_hides_internal_messages(fixture: JobFixture, monkeypatch):
    fixture.publish()

    def broken(*arguments, **options):
        raise ValueError("/secret/place")

    monkeypatch.setattr(steps_module, "resume_refinement", broken)
    row = fixture.run_job("j")
    assert (row.state, row.detail) == ("failed", "internal error (ValueError); see the worker's log")


def test_detail_of_a_library_error_is_its_message(fixture: JobFixture, monkeypatch):
    fixture.publish()

    def refused(*arguments, **options):
        raise OutOfRange("that is too much")

    monkeypatch.setattr(steps_module, "resume_refinement", refused)
    assert fixture.run_job("j").detail == "that is too much"


def test_only_an_unavailable_store_is_retried():
    assert transient(StoreUnavailable("gone"))
    assert not transient(OutOfRange("no"))
    assert not transient(OSError("no"))


def test_usage_lowers_the_error_at_requested_adverbs(fixture: JobFixture):
    fixture.publish()
    verb = library.load("arm3")
    requested = clustered(verb, np.random.default_rng(5), 4_000)
    fixture.store.put_usage("arm3", "server", cells_json(verb, requested), 2e9)
    uniform = fixture.run_job("uniform", max_pseudo=16)
    fixture.store.activate("arm3", 1, author="test", reason="compare")
    weighted = fixture.run_job("weighted", max_pseudo=16, weighted_by_traffic=True)
    assert weighted.progress["pseudo"] == uniform.progress["pseudo"] == 16
    assert weighted.progress["curve_traffic"][-1][1] < uniform.progress["curve"][-1][1]
    fresh, errors = clustered(verb, np.random.default_rng(6), 2_000), []
    for row in (uniform, weighted):
        published = artifact.load(fixture.store.path(fixture.store.version("arm3", row.version_after)))
        errors.append(Evaluator(published).blend(fresh, method="refined").error.mean())
    assert errors[1] < 0.8 * errors[0]
    assert published.provenance["refinement"]["weighted_by_traffic"]


def test_job_notes_missing_usage(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", weighted_by_traffic=True)
    assert row.progress["note"] == "no usage was recorded"
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
def test_invalid_parameters_are_refused(values, error, match):
    with pytest.raises(error, match=match):
        RefinementSpec.from_json(values)
