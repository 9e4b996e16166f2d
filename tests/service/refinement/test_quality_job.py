"""Jobs that refine for quality, without queue and processes."""

from __future__ import annotations

import numpy as np
import pytest

from service.refinement.job_spec import RefinementSpec
from service.refinement.worker.quality_checkpoint import QualityCheckpoint, resume_quality
from service.refinement.worker.steps import JobSteps
from tests.service.refinement.conftest import JobFixture
from verbs import library, refine_quality
from verbs.domain import random_points
from verbs.errors import OutOfRange, UnknownName
from verbs.io import artifact
from verbs.runtime.evaluate import Evaluator

QUALITY = {"aim": "quality", "max_pseudo": 1}


def offline(verb=None, *, max_pseudo=1):
    verb, rules = verb or library.load("arm3"), refine_quality.Rules(max_pseudo=max_pseudo, seed=1)
    *_, last = refine_quality.refine(verb, rules)
    return refine_quality.with_basis(verb, last.basis, rules, last.mark), last


@pytest.fixture
def lenient(monkeypatch):
    """An arm of nine examples gains little; whether that is enough is not the question here."""
    monkeypatch.setattr("verbs.refine_quality.judge._reasons", lambda now, new, better, worse, *, stands: [])


@pytest.mark.usefixtures("lenient")
def test_a_job_publishes_the_bytes_that_the_library_gives(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", **QUALITY)
    verb, last = offline()
    path = fixture.folder / "offline.verb"
    artifact.save(verb, path)
    version = fixture.store.current()["arm3"]
    assert (row.state, row.version_after) == ("published", 2)
    assert fixture.store.path(version).read_bytes() == path.read_bytes()
    assert [point[0] for point in row.progress["curve"]] == [0, 1]
    assert row.progress["cost_mean"] == last.after.mean
    assert row.progress["stopped"] == "most pseudo-examples reached"
    assert row.progress["ratio"] == 1.0
    assert row.request["for"] == "quality"


@pytest.mark.usefixtures("lenient")
def test_job_and_version_have_figures_before_and_after(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", **QUALITY)
    figures = row.progress["figures"]
    assert figures["new"]["cost_mean"] < figures["now"]["cost_mean"]
    assert figures["new"]["error_max_m"] < 1e-9
    assert figures["for"] == "quality"
    assert figures["against"] == 1
    assert set(figures["worst"][0]["adverbs"]) == {"x", "y"}
    version = fixture.store.current()["arm3"]
    assert version.quality == figures
    assert version.reason.startswith("at 200 held-out goals the mean cost is")


@pytest.mark.usefixtures("lenient")
def test_the_published_version_answers_by_corrected_otherwise_and_as_exactly(fixture: JobFixture):
    fixture.publish()
    fixture.run_job("j", **QUALITY)
    new = Evaluator(artifact.load(fixture.store.path(fixture.store.current()["arm3"])))
    verb = library.load("arm3")
    goals = random_points(verb, np.random.default_rng(0), 50)
    blend, before = new.blend(goals), Evaluator(verb).blend(goals)
    assert blend.method == "corrected"
    assert blend.error.max() < 1e-9
    assert np.abs(blend.weights - before.weights).max() > 1e-3


def test_a_result_that_breaks_the_rule_is_not_published(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", **QUALITY)
    assert (row.state, row.version_after) == ("not_better", None)
    assert row.detail.startswith("not better: its mean cost does not fall by 5 %; at 200 held-out goals")
    assert row.progress["figures"]["better"] is False
    assert fixture.store.current()["arm3"].number == 1


@pytest.mark.usefixtures("lenient")
def test_any_step_can_be_done_twice_and_one_step_is_one_attempt(fixture: JobFixture):
    fixture.publish()
    names = []

    def twice(name, function, *arguments):
        names.append(name)
        JobFixture.step(name, function, *arguments)
        return JobFixture.step(name, function, *arguments)

    steps = JobSteps(fixture.store, str(fixture.folder / "verbs"), step=twice, step_s=0.0)
    steps.run(fixture.add_job("j", aim="quality", max_pseudo=2))
    row, (_, last) = fixture.store.job("j"), offline(max_pseudo=2)
    assert row.state == "published"
    assert row.progress["steps"] == last.mark.number
    assert names.count("advance") == last.mark.number + 1
    assert row.progress["cost_mean"] == last.after.mean


def test_checkpoints_survive_encoding(fixture: JobFixture):
    verb, rules = library.load("arm3"), refine_quality.Rules(max_pseudo=2, samples=40)
    once = resume_quality(verb, QualityCheckpoint.start(verb), rules, should_stop=lambda: False)
    cut = QualityCheckpoint.start(verb)
    while not cut.stopped:
        cut = QualityCheckpoint.from_bytes(resume_quality(verb, cut, rules, should_stop=lambda: True).to_bytes())
    assert cut.to_bytes() == once.to_bytes()
    assert cut.mark == once.mark


def test_the_budget_ends_a_job(fixture: JobFixture):
    fixture.publish()
    row = fixture.run_job("j", **QUALITY, budget_s=1e-6)
    assert row.progress["stopped"] == "budget spent"
    assert row.progress["pseudo"] == 0
    assert row.state == "not_better"


@pytest.mark.parametrize(
    ("given", "exact", "aim", "most"),
    [
        ({}, True, "quality", 8),
        ({}, False, "error", 300),
        ({"target_error": 0.01}, True, "error", 300),
        ({"method": "hybrid", "max_pseudo": 5}, True, "error", 5),
        ({"for": "error"}, True, "error", 300),
        ({"for": "quality", "max_pseudo": 4}, False, "quality", 4),
    ],
)
def test_the_aim_follows_from_verb_and_options(given, exact, aim, most):
    spec = RefinementSpec.of_request(given, exact=exact)
    assert (spec.aim, spec.max_pseudo) == (aim, most)
    assert RefinementSpec.from_json(spec.to_json()) == spec
    assert spec.to_json()["for"] == aim


def test_jobs_of_earlier_versions_are_for_errors():
    assert RefinementSpec.from_json({"max_pseudo": 5}).aim == "error"


@pytest.mark.parametrize(
    ("given", "error", "match"),
    [
        ({"for": "quality", "target_error": 0.1}, OutOfRange, "target_error has no meaning"),
        ({"for": "fun"}, UnknownName, "unknown for"),
        ({"for": "quality", "max_pseudo": 65}, OutOfRange, "max_pseudo is 65"),
    ],
)
def test_options_without_meaning_are_refused(given, error, match):
    with pytest.raises(error, match=match):
        RefinementSpec.of_request(given, exact=True)
