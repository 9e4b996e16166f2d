"""Maps of quality over a plane of adverbs."""

import numpy as np
import pytest

from tests.verbs.sources import arm_motion, example_row, write_source
from verbs import Evaluator, library
from verbs.authoring.fit import build
from verbs.domain import slices
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.quality import quality_map
from verbs.quality.smoothness import slice_curvature


@pytest.fixture(scope="module")
def reach():
    return Evaluator(library.load("reach"))


def test_a_map_of_two_adverbs_is_the_slice_that_reports_are_made_of():
    arm = Evaluator(library.load("arm3"))
    found, (whole,) = quality_map.over(arm, method="rbf", nodes=61), slices(arm.verb, 61)
    np.testing.assert_array_equal(found.inside, whole.inside.T)
    np.testing.assert_allclose(found.smoothness, slice_curvature(arm, "rbf", whole).T, atol=1e-12)


def test_support_is_high_near_examples_and_nan_outside(reach):
    inner = reach.verb.values[np.argmin(np.linalg.norm(reach.verb.values - reach.verb.values.mean(axis=0), axis=1))]
    found = quality_map.over(reach, across="x", up="y", held={"z": float(inner[2])}, nodes=41)
    np.testing.assert_array_equal(np.isnan(found.support), ~found.inside)
    row, column = np.argmin(np.abs(found.rows - inner[1])), np.argmin(np.abs(found.columns - inner[0]))
    assert found.support[row, column] > 0.9
    assert np.nanmin(found.support) < 0.7


def test_what_is_held_is_held_and_the_rest_is_at_mid_range(reach):
    found = quality_map.over(reach, across="z", held={"x": -0.2}, nodes=5)
    y = reach.verb.adverbs[1]
    assert (found.across, found.up, found.held) == ("z", "y", {"x": -0.2})
    assert (found.rows[0], found.rows[-1]) == (y.minimum, y.maximum)


def test_one_adverb_makes_a_line(tmp_path):
    angles = [0.1, 0.4, 0.8, 1.1]
    rows = [example_row(f"e{k}", [0.0, 0.5, 1.0], [angle]) for k, angle in enumerate(angles)]
    head = 'name = "nod"\nkeytime_names = ["start", "low", "end"]\n[[adverb]]\nname = "angle"\nunit = "rad"\n'
    motions = {f"e{k}": arm_motion(angle, 0.0) for k, angle in enumerate(angles)}
    nod = Evaluator(build(write_source(tmp_path / "nod", motions, rows, head + "style = true\n")).verb)
    found = quality_map.over(nod, nodes=9)
    assert (found.across, found.up, found.held) == ("angle", "angle", {})
    assert found.error.shape == found.smoothness.shape == (1, 9)
    assert np.isnan(found.error).all()
    assert np.isfinite(found.smoothness[0, 1:-1]).all()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"across": "q"}, UnknownName),
        ({"across": "x", "up": "x"}, RequestError),
        ({"across": "x", "held": {"x": 0.0}}, RequestError),
        ({"held": {"x": 0.0, "y": 1.0}}, RequestError),
        ({"held": {"z": np.inf}}, OutOfRange),
        ({"nodes": 2}, OutOfRange),
        ({"nodes": 102}, OutOfRange),
        ({"method": "magic"}, UnknownName),
    ],
)
def test_invalid_options_are_refused(reach, options, problem):
    with pytest.raises(problem):
        quality_map.over(reach, **options)
