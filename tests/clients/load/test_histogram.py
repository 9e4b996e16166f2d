"""Histograms, schedules and series of the load tester."""

import itertools
import math

import numpy as np
import pytest
from adverb_load.histogram import PERCENTILES, PRECISION, Histogram
from adverb_load.schedule import arrivals
from adverb_load.series import Counts, Series


@pytest.mark.parametrize("spread", [0.1, 1.0, 4.0])
def test_percentiles_are_within_the_precision(spread):
    values = np.exp(np.random.default_rng(3).normal(-6.0, spread, 20_000))
    found = Histogram()
    found.add(values)
    for percent in PERCENTILES:
        exact = float(np.sort(values)[-(-round(10 * percent) * len(values) // 1000) - 1])
        assert found.percentile(percent) == pytest.approx(exact, rel=PRECISION * 1.001)
    assert found.percentile(100.0) == values.max()
    assert found.mean == pytest.approx(values.mean())


def test_extremes_are_exact_and_others_do_not_count():
    found = Histogram()
    found.add([0.0, 5e-324, 0.003, math.nan, math.inf])
    assert (found.total, found.min, found.max) == (3, 0.0, 0.003)
    assert found.percentile(1.0) < 1.01e-9
    assert math.isnan(Histogram().percentile(50.0))
    assert Histogram().summary()["p50"] is None


def test_json_keeps_a_histogram():
    found = Histogram()
    found.add(np.geomspace(1e-8, 1e4, 500))
    again = Histogram.of_json(found.to_json())
    assert again.summary() == found.summary()
    merged = Histogram()
    merged.merge(found)
    merged.merge(again)
    assert merged.total == 1000


@pytest.mark.parametrize("fields", [
    {}, {"buckets": [1], "counts": [1, 2], "sum": 0}, {"buckets": [-1], "counts": [1], "sum": 0, "min": 0, "max": 0},
    {"buckets": [10**6], "counts": [1], "sum": 0, "min": 0, "max": 0}, {"buckets": "x", "counts": [1], "sum": 0},
])  # fmt: skip
def test_what_is_no_histogram_is_refused(fields):
    with pytest.raises(ValueError, match="histogram|fit|base 10"):
        Histogram.of_json(fields)


def test_constant_arrivals_have_equal_intervals():
    times = list(itertools.islice(arrivals(50.0, "constant", np.random.default_rng(1)), 200))
    assert np.diff(times) == pytest.approx(np.full(199, 0.02))
    assert 0.0 <= times[0] < 0.02


def test_poisson_arrivals_have_exponential_intervals():
    times = np.array(list(itertools.islice(arrivals(50.0, "poisson", np.random.default_rng(1)), 20_000)))
    gaps = np.diff(times)
    assert gaps.mean() == pytest.approx(0.02, rel=0.03)
    assert gaps.std() == pytest.approx(0.02, rel=0.05)  # the deviation of an exponential distribution is its mean
    assert gaps.min() >= 0.0


@pytest.mark.parametrize(
    ("rate", "kind"), [(0.0, "poisson"), (-1.0, "constant"), (math.nan, "poisson"), (1.0, "burst")]
)
def test_impossible_arrivals_are_refused(rate, kind):
    with pytest.raises(ValueError, match="arrivals"):
        arrivals(rate, kind, np.random.default_rng(1))


def test_series_sort_values_into_their_intervals():
    series = Series(0.5)
    series.add(9.0, 1.0)  # before the window
    series.window(10.0, 2.0)
    for when, value in ((9.9, 7.0), (10.1, 1.0), (10.6, 2.0), (10.7, 4.0), (11.99, 8.0), (12.0, 9.0)):
        series.add(when, value)
    assert [part.total for part in series.parts(2.0)] == [1, 2, 0, 1]
    assert series.whole(2.0).max == 8.0
    assert series.whole(1.0).total == 3  # an interrupted run


def test_counts_belong_to_intervals():
    counts = Counts(1.0)
    counts.window(5.0, 3.0)
    for when, name in ((4.9, "a"), (5.0, "a"), (7.9, "a"), (8.0, "a"), (6.5, "b")):
        counts.add(when, name, 2)
    assert counts.parts("a", 3.0) == [2, 0, 2]
    assert (counts.total("a"), counts.total("b"), counts.names()) == (4, 2, ["a", "b"])
