from __future__ import annotations

import math

import numpy as np
import pytest

from service.refinement.worker import checkpoint as checkpoints
from service.refinement.worker.checkpoint import Checkpoint, resume_refinement
from verbs import library
from verbs.domain import random_points
from verbs.refine import Rules, refine

RULES = Rules(target_error=0.0, max_pseudo=8)


def finished(verb, sets, rules=RULES, *, should_stop=lambda: True):
    """The last checkpoint of a refinement, encoded and decoded after every step."""
    checkpoint = Checkpoint.start(verb, len(sets))
    while not checkpoint.stopped:
        checkpoint = Checkpoint.from_bytes(
            resume_refinement(verb, checkpoint, rules, sets, should_stop=should_stop).to_bytes()
        )
    return checkpoint


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_bytes_give_the_course_back(name):
    verb = library.load(name)
    start = Checkpoint.start(verb, 2)
    assert Checkpoint.from_bytes(start.to_bytes()).to_bytes() == start.to_bytes()
    assert Checkpoint.from_bytes(start.to_bytes()).marks[0].best == math.inf
    checkpoint = resume_refinement(verb, start, Rules(samples=50), [None, None], should_stop=lambda: True)
    assert Checkpoint.from_bytes(checkpoint.to_bytes()).to_bytes() == checkpoint.to_bytes()


@pytest.mark.parametrize("weighted", [False, True])
def test_result_does_not_depend_on_where_steps_end(weighted):
    verb = library.load("arm3")
    sets = [None, random_points(verb, np.random.default_rng(0), 200)] if weighted else [None]
    assert finished(verb, sets).to_bytes() == finished(verb, sets, should_stop=lambda: False).to_bytes()


def test_one_set_gives_the_result_of_the_library():
    verb = library.load("arm3")
    checkpoint, steps = finished(verb, [None]), list(refine(verb, RULES))
    assert checkpoint.mark == steps[-1].mark
    assert np.array_equal(checkpoint.basis.radial, steps[-1].basis.radial)
    assert checkpoint.curves == (tuple((step.pseudo, step.after.mean, step.after.largest) for step in steps),)


def test_two_sets_alternate_and_share_the_pseudo_examples():
    verb = library.load("arm3")
    checkpoint = finished(verb, [None, random_points(verb, np.random.default_rng(0), 200)])
    assert len(checkpoint.basis.centers) - len(verb.values) == RULES.max_pseudo
    assert abs(checkpoint.marks[0].number - checkpoint.marks[1].number) <= 1
    assert checkpoint.steps == RULES.max_pseudo
    assert checkpoint.stopped == "most pseudo-examples reached"


def test_two_sets_both_meet_the_target():
    verb = library.load("arm3")
    corner = verb.values[:1] + 1e-3 * random_points(verb, np.random.default_rng(0), 5)
    checkpoint = finished(verb, [None, corner], Rules(target_error=0.03))
    assert checkpoint.stopped == "target met"
    assert [curve[-1][2] <= 0.03 for curve in checkpoint.curves] == [True, True]


def test_long_curves_are_thinned_where_they_are_dense(monkeypatch):
    monkeypatch.setattr(checkpoints, "MAX_CURVE", 10)
    curve = ()
    for pseudo in range(100):
        curve = checkpoints._append_point(curve, (pseudo, 0.0, 0.0))
    positions = [row[0] for row in curve]
    assert len(positions) == 10
    assert (positions[0], positions[1], positions[-1]) == (0, 1, 99)
    assert max(np.diff(np.log1p(positions))) < 1.2
