"""The verb ``arm3``: a planar arm of three links whose tip reaches for nine points of a sheet.

It is the arm of C. Rose, P. Sloan, M. Cohen, "Artist-Directed Inverse-Kinematics Using Radial Basis Function
Interpolation", 2001, figure 6, with our own examples: the joint angles nearest to rest that reach a 3 × 3 grid,
rounded to 4 decimals and then taken as they are (benchmark table A9).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tools.authoring import timing
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64, Floats
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["FPS", "LINKS_M", "POSES_RAD", "REST_RAD", "motion", "source", "tip"]

FPS = 60.0
LINKS_M = (0.40, 0.35, 0.25)
REST_RAD = (-0.6, 0.9, 0.6)
POSES_RAD = {
    "low_near": (-2.1846, 1.2046, 1.7150),
    "low_middle": (-1.6864, 1.0955, 1.1967),
    "low_far": (-1.1000, 0.6995, 0.5733),
    "level_near": (-1.1978, 2.0532, 1.8381),
    "level_middle": (-1.1851, 1.5418, 1.3281),
    "level_far": (-0.8151, 1.0480, 0.7668),
    "high_near": (-0.0689, 1.7401, 0.9268),
    "high_middle": (-0.2502, 1.3732, 0.8123),
    "high_far": (-0.0506, 0.8018, 0.4311),
}
"""Angles of the three joints at the reach, each relative to the link before it: table A9, in its order."""


def source() -> Source:
    """Return the verb source of ``arm3``."""
    return Source(
        comment=(
            "A planar three-link arm, authored by tools.authoring (python -m tools.authoring arm3).\n"
            "`rotations`: blend rotation vectors, not quaternions. All turns are about Z, so a rotation vector is\n"
            "the joint angle itself, the degree of freedom that the paper interpolates; its figures depend on it."
        ),
        keys={
            "name": "arm3",
            "description": "A planar arm of three links (0.40, 0.35, 0.25 m) reaches for a point of a sheet.",
            "looping": False,
            "root": "Shoulder",
            "effector": "Tip",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "rotations": "rotation_vector",
            "fps": FPS,
            "keytime_names": ["start", "reach", "end"],
        },
        adverbs=(
            Adverb("x", "m", "+X coordinate of the tip at the reach (keytime 1), from the shoulder"),
            Adverb("y", "m", "+Y coordinate of the tip at the reach (keytime 1), from the shoulder"),
        ),
        examples=_examples(),
        decimals=8,
    )


def motion(angles: Floats) -> tuple[Motion, F64]:
    """Author one reach: from rest to joint angles (3,), held for an instant, and back.

    Returns
    -------
    motion : Motion
        60 frames a second.
    keytimes : (3,) float64
        Start, reach, end, seconds; all on frames.
    """
    # A tip that travels farther takes longer: 0.6 s and a quarter of a second per metre, the way back a tenth more.
    duration_s = 0.60 + 0.25 * float(np.linalg.norm(tip(angles) - tip(np.array(REST_RAD))))
    out, back = round(duration_s * FPS), round(1.1 * duration_s * FPS)
    phases = np.concatenate([np.arange(out) / out, 1.0 + np.arange(back + 1) / back])
    progress = timing.there_and_back(phases, (0.0, 1.0), (0.0, 1.0))[:, None]
    vectors = np.zeros((len(phases), 4, 3))
    vectors[:, :3, 2] = (1.0 - progress) * REST_RAD + progress * np.asarray(angles)
    keytimes = np.array([0, out, out + back]) / FPS
    return Motion(_skeleton(), FPS, np.zeros((len(phases), 3)), quat.exp(vectors)), keytimes


def tip(angles: Floats) -> F64:
    """Position of the tip (..., 2) for joint angles (..., 3): Σ L_k (cos, sin)(θ_1 + … + θ_k)."""
    headings = np.cumsum(np.asarray(angles, np.float64), axis=-1)
    links = np.array(LINKS_M)
    return np.stack([np.cos(headings) @ links, np.sin(headings) @ links], axis=-1)


def _examples() -> Iterator[Example]:
    for name, angles in POSES_RAD.items():
        yield Example(name, *motion(np.array(angles)))


def _skeleton() -> Skeleton:
    offsets = np.zeros((4, 3))
    offsets[1:, 0] = LINKS_M
    return Skeleton(("Shoulder", "Elbow", "Wrist", "Tip"), np.array([-1, 0, 1, 2]), offsets)
