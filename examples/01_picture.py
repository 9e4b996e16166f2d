"""Draw a picture: one verb, eight goals between its examples, the wrist on each of them.

Run: python examples/01_picture.py [FILE]
"""

from __future__ import annotations

import sys

import numpy as np

from verbs import Evaluator, library
from verbs.figures.draw import draw_poses, points

GOALS = np.array(
    [
        [0.14, 0.64, 0.46],
        [0.16, 0.95, 0.52],
        [0.08, 1.30, 0.55],
        [-0.05, 1.62, 0.50],
        [-0.30, 1.66, 0.40],
        [-0.52, 1.38, 0.36],
        [-0.62, 1.02, 0.26],
        [-0.50, 0.66, 0.34],
    ]
)


def main(path: str = "docs/reach.png") -> None:
    """Evaluate the goals in one batch and draw them."""
    reach = Evaluator(library.load("reach"))
    poses = reach.pose(GOALS, phase=np.full(len(GOALS), reach.verb.phases[1]))
    figures = points(reach.verb.skeleton, poses.root, poses.rotations)
    labels = [f"goal {x:.2f} {y:.2f} {z:.2f} m" for x, y, z in GOALS]
    draw_poses(reach.verb.skeleton, list(figures), path, labels=labels, marks=list(GOALS), pixels_per_m=140)
    print(f"{path}: largest error {poses.blend.error.max():.1e} m")


if __name__ == "__main__":
    main(*sys.argv[1:])
