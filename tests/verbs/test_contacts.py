from dataclasses import replace

import numpy as np
import pytest

from verbs.contacts import Contacts
from verbs.errors import IllPosedVerb


def contacts(**changes):
    fields = {
        "feet": np.array([2, 2]),
        "joints": np.array([2, 3]),
        "parts": np.array([0, 1]),
        "offsets": np.zeros((2, 3)),
        "heights": np.zeros((3, 2)),
        "values": np.full((5, 3, 2), 0.5, np.float32),
        "intervals": np.array([[0.0, 0.4], [0.5, 1.2], [0.1, 0.3]]),
        "owners": np.array([[0, 1], [0, 1], [2, 0]]),
    }
    return Contacts(**(fields | changes))


def test_intervals_are_found_by_example_and_point():
    known = contacts()
    np.testing.assert_array_equal(known.of(0, 1), [[0.0, 0.4], [0.5, 1.2]])
    assert known.of(1, 1).shape == (0, 2)
    assert len(known) == 2


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        contacts().values[0] = 1


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"feet": np.zeros(0, np.int64)}, "points"),
        ({"parts": np.array([0, 4])}, "part"),
        ({"parts": np.array([1, 1])}, "twice"),
        ({"offsets": np.zeros((2, 2))}, "offsets"),
        ({"offsets": np.full((2, 3), np.nan)}, "finite"),
        ({"heights": np.zeros((2, 2))}, "heights"),
        ({"values": np.full((5, 3, 2), 1.5, np.float32)}, "0 to 1"),
        ({"values": np.full((5, 3, 2), np.nan, np.float32)}, "0 to 1"),
        ({"values": np.zeros((5, 3), np.float32)}, "values"),
        ({"intervals": np.array([[0.0, 0.4], [0.3, 1.2], [0.1, 0.3]])}, "overlap"),
        ({"intervals": np.array([[0.0, 0.4], [0.5, 0.5], [0.1, 0.3]])}, "interval"),
        ({"intervals": np.array([[0.0, 0.4], [0.5, 1.6], [0.1, 0.3]])}, "interval"),
        ({"intervals": np.array([[-0.1, 0.4], [0.5, 1.2], [0.1, 0.3]])}, "interval"),
        ({"intervals": np.zeros((2, 2))}, "columns"),
        ({"owners": np.array([[0, 1], [0, 1], [3, 0]])}, "does not exist"),
        ({"owners": np.array([[0, 1], [0, 1], [0, 0]])}, "order"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(changes, problem):
    with pytest.raises(IllPosedVerb, match=problem):
        contacts(**changes)


def test_a_subset_keeps_the_chosen_examples_in_their_new_order():
    known = contacts(heights=np.arange(6.0).reshape(3, 2))
    some = known.subset(np.array([2, 0]))
    np.testing.assert_array_equal(some.of(0, 0), known.of(2, 0))
    np.testing.assert_array_equal(some.of(1, 1), known.of(0, 1))
    np.testing.assert_array_equal(some.heights, [[4.0, 5.0], [0.0, 1.0]])
    assert some.values.shape == (5, 2, 2)
    assert replace(some).subset(np.array([0])).intervals.shape == (1, 2)
