"""Easing curves."""

import numpy as np

from verbs.kernels.easing import smootherstep


def test_the_quintic_is_flat_at_both_ends_and_constant_outside() -> None:
    np.testing.assert_array_equal(smootherstep(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])), [0.0, 0.0, 0.5, 1.0, 1.0])
    step = 1e-3
    near = smootherstep(np.array([[step, 2.0 * step], [1.0 - step, 1.0 - 2.0 * step]]))
    assert near.shape == (2, 2)
    np.testing.assert_allclose(near, [[1e-8, 8e-8], [1.0 - 1e-8, 1.0 - 8e-8]], rtol=0.01, atol=1e-9)
