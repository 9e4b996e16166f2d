"""A job gives the result of the library on every built-in verb: same seed, same figures, same bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.refinement.job_spec import RefinementSpec
from service.refinement.worker.acceptance import held_out
from service.store.records import Job
from tests.service.refinement.conftest import JobFixture
from verbs import library
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.runtime.evaluate import Evaluator

PSEUDO = 8


@pytest.mark.parametrize("name", ["arm3", "board", "reach"])
def test_a_job_reaches_the_error_that_refine_reaches(fixture: JobFixture, name: str):
    verb, rules = library.load(name), Rules(target_error=0.0, max_pseudo=PSEUDO, seed=3)
    *_, last = refine(verb, rules)
    alone = with_basis(verb, last.basis, rules, last.mark)
    file = Path(library.__file__).with_name(f"{name}.verb")
    fixture.store.publish(name, file, author="test", reason="test", quality={})
    requested = RefinementSpec(target_error=0.0, max_pseudo=PSEUDO, seed=3).to_json() | {"author": "test"}
    fixture.store.add_job(Job("j", name, "queued", requested, {}, 0, 1, None, "", 1.0, 1.0))
    fixture.steps.run("j")
    row = fixture.store.job("j")
    assert row.state == "published"
    assert (row.progress["error_mean"], row.progress["error_max"]) == (last.after.mean, last.after.largest)
    published = artifact.load(fixture.store.path(fixture.store.version(name, 2)))
    points = held_out(verb, 3, None)
    errors = [Evaluator(one).blend(points, method="refined").error for one in (published, alone)]
    assert np.array_equal(*errors)
    figures = row.progress["figures"]["new"]
    assert (figures["error_mean_m"], figures["error_max_m"]) == (errors[0].mean(), errors[0].max())
    assert errors[0].mean() < 0.75 * Evaluator(verb).blend(points, method="rbf").error.mean()
