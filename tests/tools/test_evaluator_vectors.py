"""The vectors for evaluators in other languages are what this library computes."""

import json

import numpy as np
import pytest

from tools import evaluator_vectors

STORED = json.loads(evaluator_vectors.PATH.read_text("utf-8"))
FRESH = evaluator_vectors.vectors()


@pytest.mark.parametrize(("stored", "fresh"), [*zip(STORED["verbs"], FRESH["verbs"], strict=True)])
def test_the_stored_vectors_are_current(stored, fresh):
    hint = "run `python -m tools.evaluator_vectors`"
    assert (stored["file"], stored["sha256"]) == (fresh["file"], fresh["sha256"]), hint
    for kind in ("weights", "adverbs"):
        for old, new in zip(stored[kind], fresh[kind], strict=True):
            np.testing.assert_allclose(old["positions"], new["positions"], atol=1e-7, err_msg=hint)
            np.testing.assert_allclose(list(old["at"].values()), list(new["at"].values()), atol=1e-7)


def test_they_have_all_kinds_of_verbs():
    cases = [case for verb in STORED["verbs"] for case in verb["adverbs"]]
    assert any(case["clamped"] for case in cases)
    assert not all(case["clamped"] for case in cases)
    assert {case["method"] for case in cases} == {"rbf", "refined"}
    assert any(case.get("phase", 0.0) > 2.0 for case in cases), "no cycle of a loop after the first"
