from __future__ import annotations

import math

import numpy as np
import pytest

from service.refinement.worker import checkpoint as courses
from service.refinement.worker.checkpoint import Course, go_on
from verbs import library
from verbs.domain import random_points
from verbs.refine import Rules, refine

RULES = Rules(target_error=0.0, max_pseudo=8)


def finished(verb, sets, rules=RULES, *, enough=lambda: True):
    """A course that is carried through bytes after every cut."""
    course = Course.start(verb, len(sets))
    while not course.stopped:
        course = Course.of_bytes(go_on(verb, course, rules, sets, enough=enough).to_bytes())
    return course


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_bytes_give_the_course_back(name):
    verb = library.load(name)
    start = Course.start(verb, 2)
    assert Course.of_bytes(start.to_bytes()).to_bytes() == start.to_bytes()
    assert Course.of_bytes(start.to_bytes()).marks[0].best == math.inf
    course = go_on(verb, start, Rules(samples=50), [None, None], enough=lambda: True)
    assert Course.of_bytes(course.to_bytes()).to_bytes() == course.to_bytes()


@pytest.mark.parametrize("weighted", [False, True])
def test_cuts_change_nothing(weighted):
    verb = library.load("arm3")
    sets = [None, random_points(verb, np.random.default_rng(0), 200)] if weighted else [None]
    assert finished(verb, sets).to_bytes() == finished(verb, sets, enough=lambda: False).to_bytes()


def test_one_set_goes_the_way_of_the_library():
    verb = library.load("arm3")
    course, steps = finished(verb, [None]), list(refine(verb, RULES))
    assert course.mark == steps[-1].mark
    assert np.array_equal(course.basis.radial, steps[-1].basis.radial)
    assert course.curves == (tuple((step.pseudo, step.after.mean, step.after.largest) for step in steps),)


def test_two_sets_take_turns_and_share_the_pseudo_examples():
    verb = library.load("arm3")
    course = finished(verb, [None, random_points(verb, np.random.default_rng(0), 200)])
    assert len(course.basis.centers) - len(verb.values) == RULES.max_pseudo
    assert abs(course.marks[0].number - course.marks[1].number) <= 1
    assert course.steps == RULES.max_pseudo
    assert course.stopped == "most pseudo-examples reached"


def test_two_sets_both_meet_the_target():
    verb = library.load("arm3")
    corner = verb.values[:1] + 1e-3 * random_points(verb, np.random.default_rng(0), 5)
    course = finished(verb, [None, corner], Rules(target_error=0.03))
    assert course.stopped == "target met"
    assert [curve[-1][2] <= 0.03 for curve in course.curves] == [True, True]


def test_long_curves_are_thinned_where_they_are_dense(monkeypatch):
    monkeypatch.setattr(courses, "MAX_CURVE", 10)
    curve = ()
    for pseudo in range(100):
        curve = courses._longer(curve, (pseudo, 0.0, 0.0))
    places = [row[0] for row in curve]
    assert len(places) == 10
    assert (places[0], places[1], places[-1]) == (0, 1, 99)
    assert max(np.diff(np.log1p(places))) < 1.2
