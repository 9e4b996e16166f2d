"""Cost of poses and weights: single, batched, and against SciPy's interpolator on the same examples."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from benchmarks.timing import interleave
from verbs import Evaluator, library
from verbs.blend.cardinal import basis_weights
from verbs.blend.corrected import Corrected
from verbs.domain import random_points
from verbs.kernels import radial_basis
from verbs.kernels.compile import kernel


@kernel
def _compiled_loop(points, basis, out):
    """A compiled caller evaluates point by point, as a game's own loop would."""
    _, function, degree, centers, radii, radial, poly = basis
    row = np.empty(poly.shape[0])
    for point in points:
        radial_basis.evaluate_at(point, function, degree, centers, radii, radial, poly, row, out)


def main() -> None:
    """Print one table."""
    verb = library.load("reach")
    evaluator = Evaluator(verb)
    rng = np.random.default_rng(0)
    rows, phases = random_points(verb, rng, 1_000), rng.uniform(size=1_000)
    one, basis = rows[:1].copy(), verb.bases["rbf"]
    normal = (rows - basis.chart.shift) * basis.chart.scale
    interpolator = RBFInterpolator(basis.centers, np.eye(len(basis.centers)), kernel="linear", degree=1)
    three = Corrected.of_verb(verb, steps=3)
    out = np.empty(len(verb.examples))
    best = interleave(
        {
            "pose, 100 single, corrected": lambda: [evaluator.pose(one, phase=0.4) for _ in range(100)],
            "pose, 100 single, rbf": lambda: [evaluator.pose(one, phase=0.4, method="rbf") for _ in range(100)],
            "poses, batch of 1,000, corrected": lambda: evaluator.pose(rows, phase=phases),
            "poses, batch of 1,000, rbf": lambda: evaluator.pose(rows, phase=phases, method="rbf"),
            "weights rbf, batch": lambda: basis_weights(basis, rows),
            "weights rbf, compiled loop": lambda: _compiled_loop(normal, basis.arrays, out),
            "weights corrected K=3, batch": lambda: three.weights(rows),
            "scipy RBFInterpolator, batch": lambda: interpolator(normal),
            "scipy RBFInterpolator, 100 single": lambda: [interpolator(normal[k : k + 1]) for k in range(100)],
        }
    )
    print(f"reach: {len(verb.examples)} examples, {len(verb.skeleton)} joints")
    each = {}
    for name, seconds in best.items():
        count = 100 if "100 single" in name else 1_000
        each[name] = 1e6 * seconds / count
        print(f"  {name:<36}{each[name]:>10.3f} µs each")
    ratio = each["scipy RBFInterpolator, 100 single"] / each["weights rbf, compiled loop"]
    print(f"  scipy single query / own, compiled loop: {ratio:.0f}×")
    print(f"  scipy batch / own batch: {each['scipy RBFInterpolator, batch'] / each['weights rbf, batch']:.2f}×")
    print(
        f"  corrected (K=3) / own rbf weights: {each['weights corrected K=3, batch'] / each['weights rbf, batch']:.1f}×"
    )


if __name__ == "__main__":
    main()
