import numpy as np
import pytest

from verbs import library
from verbs.quality.leave_one_out import leave_one_out
from verbs.quality.report import quality_of, recommend


@pytest.fixture(scope="module")
def rows():
    verb = library.load("arm3")
    return [quality_of(verb, name, nodes=21) for name in ("rbf", "barycentric", "corrected")]


def test_the_recommendation_names_a_method_and_its_reason(rows):
    words = recommend(rows)
    assert words.startswith("Use corrected: its largest error is")
    assert "faster, its mean error" in words


def test_kinks_show_in_the_zoom(rows):
    by_name = {row.method: row for row in rows}
    assert by_name["corrected"].zoom_ratio > 3.9
    assert by_name["barycentric"].zoom_ratio < 2.3


def test_error_grows_outside_the_hull_but_not_much_for_the_corrected(rows):
    by_name = {row.method: row for row in rows}
    assert by_name["corrected"].error_outside_mean_m < 0.1 * by_name["rbf"].error_outside_mean_m


def test_preparing_is_measured_from_the_examples(rows):
    assert all(row.precompute_s > 1e-5 for row in rows)


@pytest.mark.parametrize("name", ["punch", "reach"])
def test_left_out_examples_are_predicted_best_by_the_corrected_method(mocap, verb_of, name):
    methods = ("barycentric", "rbf", "knn", "inverse", "corrected")
    found = {row.method: row for row in leave_one_out(verb_of(name), methods)}
    best = min(row.angle_mean_rad for row in found.values())
    assert found["corrected"].angle_mean_rad <= 1.05 * best
    assert np.degrees(found["corrected"].angle_mean_rad) < 6.5
