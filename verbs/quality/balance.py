"""Balance: how far the centre of mass is outside the support polygon while a humanoid stands.

Source: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th edition, 2009, table 4.1 (masses and
centres of mass of the segments).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.clips.feet import leg_length, point_positions
from verbs.contacts import Contacts
from verbs.conventions import F64
from verbs.quality.humanoid import SIDES, Humanoid
from verbs.quality.samples import Sample

__all__ = ["MASSES", "RESTING_M_S", "SOLE_M", "Balance", "outside"]

MASSES = {
    "trunk": (0.497, 0.5), "head": (0.081, 1.0), "upper arm": (0.028, 0.436), "forearm": (0.016, 0.430),
    "hand": (0.006, 0.0), "thigh": (0.100, 0.433), "shin": (0.0465, 0.433), "foot": (0.0145, 0.5),
}  # fmt: skip
"""Share of the body's mass of each segment, and where between its ends its centre is; the hand's is at the wrist."""

RESTING_M_S = 0.2
"""Largest horizontal speed of the centre of mass in a frame that counts as standing."""

SOLE_M, LEG_M = 0.045, 0.85
"""Half of the width of a sole, by which the support polygon is grown, and the length of the leg to which it belongs."""


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Segments of a humanoid.

    Parameters
    ----------
    starts, ends : tuple of tuple of int, length S
        Joints whose mean position is the end of each segment.
    masses, shares : (S,) float64
        Shares of mass, which sum to 1, and places of the centres between the ends.
    sole_m : float
    """

    starts: tuple[tuple[int, ...], ...]
    ends: tuple[tuple[int, ...], ...]
    masses: F64
    shares: F64
    sole_m: float

    @classmethod
    def of_humanoid(cls, human: Humanoid) -> Balance:
        """Segments by standard name."""
        joints = human.joints
        hips, shoulders = (tuple(joints[side + part] for side in SIDES) for part in ("upleg", "arm"))
        rows: list[tuple[str, tuple[int, ...], tuple[int, ...]]] = [
            ("trunk", hips, shoulders), ("head", (joints["neck"],), (joints["head"],)),
        ]  # fmt: skip
        for side in SIDES:
            toes = joints.get(side + "toebase", joints[side + "foot"])
            links = [("upper arm", "arm", "forearm"), ("forearm", "forearm", "hand"), ("hand", "hand", "hand"),
                     ("thigh", "upleg", "leg"), ("shin", "leg", "foot")]  # fmt: skip
            rows += [(part, (joints[side + start],), (joints[side + end],)) for part, start, end in links]
            rows.append(("foot", (joints[side + "foot"],), (toes,)))
        masses = np.array([MASSES[part][0] for part, *_ in rows])
        leg = leg_length(human.skeleton, joints["leftfoot"])
        return cls(
            tuple(row[1] for row in rows), tuple(row[2] for row in rows), masses / masses.sum(),
            np.array([MASSES[part][1] for part, *_ in rows]), SOLE_M * leg / LEG_M,
        )  # fmt: skip

    def centre(self, positions: F64) -> F64:
        """Centre of mass (F, 3) at joint positions (F, J, 3), metres."""
        starts = np.stack([positions[:, list(joints)].mean(axis=1) for joints in self.starts], axis=1)
        ends = np.stack([positions[:, list(joints)].mean(axis=1) for joints in self.ends], axis=1)
        centres = starts + self.shares[:, None] * (ends - starts)
        return np.asarray(np.einsum("s,fsc->fc", self.masses, centres), np.float64)

    def distances(self, one: Sample, known: Contacts, standing: F64) -> F64:
        """Distance (A,) of the centre of mass outside the support polygon, metres, in the frames that count.

        These are frames in which a point stands and the centre of mass rests; ``standing`` (F, P) is their contact.
        """
        centre = self.centre(one.positions)
        resting = one.counted & (one.over_ground(centre) < RESTING_M_S) & (standing > 0.5).any(axis=1)
        paths = np.stack(
            [
                point_positions(one.global_rotations, one.positions, int(known.joints[p]), known.offsets[p])
                for p in range(len(known))
            ],
            axis=1,
        )[:, :, [0, 2]]
        gaps = [outside(centre[f, [0, 2]], paths[f, standing[f] > 0.5]) for f in np.flatnonzero(resting)]
        return np.maximum(np.array(gaps, np.float64) - self.sole_m, 0.0)


def outside(point: F64, corners: F64) -> float:
    """Distance of a point (2,) outside the convex hull of corners (K, 2), K ≥ 1; 0 inside."""
    lines = [(a, b) for k, a in enumerate(corners) for b in corners[k:]]
    starts, ways = np.array([a for a, _ in lines]), np.array([b - a for a, b in lines])
    squared = (ways**2).sum(axis=1)
    along = np.clip(((point - starts) * ways).sum(axis=1) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    nearest = float(np.linalg.norm(starts + along[:, None] * ways - point, axis=1).min())
    return 0.0 if _encloses(point, corners) else nearest


def _encloses(point: F64, corners: F64) -> bool:
    """Whether no half-plane through the point contains all corners: their directions leave no gap of 180°."""
    ways = corners - point
    angles = np.sort(np.arctan2(ways[:, 1], ways[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    return bool(gaps.max() < np.pi)
