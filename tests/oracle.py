"""The evaluation once more, in plain NumPy and SciPy: slow, obvious, and written apart from the kernels."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator

from verbs.kernels import quat
from verbs.verb import Basis, Verb


def bspline(r):
    """Cubic B-spline cross-section with support 2, from SciPy's own B-splines."""
    return BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)(np.clip(r, -2, 2))


def weights(basis: Basis, adverbs):
    """Weights (B, N) of the paper's basis in the identity chart: plane plus radial part."""
    points = (adverbs - basis.chart.shift) * basis.chart.scale
    distances = np.linalg.norm(points[:, None] - basis.centers[None], axis=-1)
    plane = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    return np.nan_to_num(bspline(distances / basis.radii)) @ basis.radial + plane @ basis.poly


def keytimes(verb: Verb, row):
    """Blended keytimes (M,): geometric means of segment lengths."""
    return np.concatenate([[0.0], np.cumsum(np.prod(np.diff(verb.keytimes, axis=1) ** row[:, None], axis=0))])


def time_at(verb: Verb, row, phase):
    """Seconds at a phase of a motion that does not loop."""
    return float(PchipInterpolator(verb.phases, keytimes(verb, row))(phase))


def sample(verb: Verb, phase):
    """Every example's row (N, C) at a phase."""
    knots = np.arange(-3, verb.intervals + 4) / verb.intervals
    return BSpline(knots, verb.curves.astype(np.float64), 3)(phase)


def pose(verb: Verb, row, phase):
    """Root (3,) and local rotations (J, 4) of weights (N,) at a phase, by quaternion sums."""
    channels = row @ sample(verb, phase)
    return channels[:3], quat.normalize(channels[4:].reshape(-1, 4))
