"""From joints that may all move to a :class:`~verbs.motion.Motion`, in which only the root does.

Rules, in this order:

- A root whose child moves is *folded* into it: the root of a root-motion rig lies on the ground, and the hips that move
  under it become the root. Their global position and rotation are exact products. The child must carry a body, that
  is, joints that branch; a chain is not folded. What else hangs on the folded joint cannot be placed, because only a
  root moves: it is left out where it holds at most a third of the joints (targets of inverse kinematics, props), and
  refused otherwise.
- Constant positions become the joint's offset.
- Positions that vary by no more than a tolerance become their mean, and the stretch is reported; more is refused.
  Up to 0.1 mm counts as rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verbs.conventions import F64, I64
from verbs.errors import MotionFileError
from verbs.io.report import Folded, Note
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["ROUNDING_M", "STRETCH_M", "JointTracks", "root_motion"]

STRETCH_M = 0.005
"""Default tolerance of joints that change their distance to the parent."""

ROUNDING_M = 1e-4
"""A stretch up to this comes from rounding in the program that wrote the file."""

_STILL_M = 1e-6
"""Positions that vary by less are constant: files round."""

MAX_FOLDED = 32
"""Joints above the body; each is a pass over all frames."""

_LEFT_OUT = 1.0 / 3.0
"""Share of the joints that may be left out beside a folded one."""


@dataclass(frozen=True, slots=True)
class JointTracks:
    """A hierarchy in which any joint may move.

    Parameters
    ----------
    names : tuple of str, length J
    parents : (J,) int64
        Parents stand before their children; -1 for joint 0 alone.
    offsets : (J, 3) float64
        Metres. Those of the root count too.
    rotations : (F, J, 4) float64
        Local rotations.
    positions : dict of int to (F, 3) float64
        Local positions of the joints whose position is animated, in place of their offset.
    tip_parents, tip_offsets : (T,) int64, (T, 3) float64
    fps : float
    places : sequence, length J
        Where each joint stands in the file: a line, or the text of a place.
    """

    names: tuple[str, ...]
    parents: I64
    offsets: F64
    rotations: F64
    positions: dict[int, F64]
    tip_parents: I64
    tip_offsets: F64
    fps: float
    places: Sequence[int | str]

    def local(self, joint: int) -> F64:
        """Local positions (F, 3) of a joint."""
        found = self.positions.get(joint)
        return np.tile(self.offsets[joint], (len(self.rotations), 1)) if found is None else found

    def children(self, joint: int) -> list[int]:
        """Indices of the joints that hang on one directly."""
        return [int(child) for child in np.flatnonzero(self.parents == joint)]

    def below(self, joint: int) -> I64:
        """Indices of a joint and of all that hang on it."""
        inside = np.zeros(len(self.names), bool)
        inside[joint] = True
        for child in range(joint + 1, len(self.names)):
            inside[child] = inside[child] or bool(inside[self.parents[child]])
        return np.flatnonzero(inside)


def root_motion(
    tracks: JointTracks, path: str, *, root: str | None = None, stretch_m: float = STRETCH_M, above: int = 0
) -> tuple[Motion, list[Note], tuple[Folded, ...]]:
    """Fold, fix and check moving joints.

    Parameters
    ----------
    tracks : JointTracks
    path : str
        For errors.
    root : str, optional
        The joint that becomes the root, whether or not it moves. Default: the last joint that moves on the way from
        the file's root to its first branch.
    stretch_m : float
        Largest distance of a joint from its mean offset that is dropped.
    above : int
        So many joints at the start are folded in any case: a chain that only carries the body.

    Returns
    -------
    motion : Motion
    notes : list of Note
    folded : tuple of Folded
        The joints above the root, outermost first.

    Raises
    ------
    MotionFileError
        A joint stretches beyond the tolerance, too much hangs on a folded joint, or ``root`` is not there.
    """
    notes: list[Note] = []
    folded: list[Folded] = []
    if root is not None and root not in tracks.names:
        shown = ", ".join(tracks.names[:5]) + ", …" * (len(tracks.names) > 5)
        raise MotionFileError(path, None, f"a joint '{root}' that becomes the root", shown, "name one of the joints")
    while (child := 1 if len(folded) < above else _next_root(tracks, root, stretch_m)) is not None:
        if len(folded) == MAX_FOLDED:
            expected = f"at most {MAX_FOLDED} joints above the body"
            raise MotionFileError(path, tracks.places[0], expected, f"'{tracks.names[0]}' below as many")
        folded.append(Folded(tracks.names[0], tracks.local(0), tracks.rotations[:, 0]))
        tracks = _folded(tracks, child, path, notes)
    offsets = tracks.offsets.copy()
    for joint in sorted(tracks.positions.keys() - {0}):
        offsets[joint] = _fixed(tracks, joint, path, stretch_m, notes)
    offsets[0] = 0.0
    skeleton = Skeleton(tracks.names, tracks.parents, offsets, tracks.tip_parents, tracks.tip_offsets)
    return Motion(skeleton, tracks.fps, tracks.local(0), tracks.rotations), notes, tuple(folded)


def _deviation(tracks: JointTracks, joint: int) -> tuple[float, int]:
    """Largest distance of a joint from its mean offset, metres, and the frame where it is reached."""
    found = tracks.positions.get(joint)
    if found is None:
        return 0.0, 0
    gaps = np.linalg.norm(found - found.mean(axis=0), axis=-1)
    return float(gaps.max()), int(np.argmax(gaps))


def _next_root(tracks: JointTracks, root: str | None, stretch_m: float) -> int | None:
    """Child of the root that takes its place; None where the root stays."""
    children = tracks.children(0)
    if root is not None:
        target = tracks.names.index(root)
        return next((child for child in children if target in tracks.below(child)), None)
    if len(children) == 1:
        trunk = _trunk(tracks, children[0])
        limits = [stretch_m] * (len(trunk) - 1) + [_STILL_M]
        moves = any(_deviation(tracks, joint)[0] > limit for joint, limit in zip(trunk, limits, strict=True))
        return children[0] if moves and tracks.children(trunk[-1]) else None
    moving = [child for child in children if _deviation(tracks, child)[0] > stretch_m and _branches(tracks, child)]
    return max(moving, key=lambda child: len(tracks.below(child)), default=None)


def _trunk(tracks: JointTracks, joint: int) -> list[int]:
    """Joints from one down to the first that has no child, or several."""
    trunk = [joint]
    while len(children := tracks.children(trunk[-1])) == 1:
        trunk.append(children[0])
    return trunk


def _branches(tracks: JointTracks, joint: int) -> bool:
    """Whether a joint, or one below it, has several children: a body does, a chain does not."""
    return bool(tracks.children(_trunk(tracks, joint)[-1]))


def _folded(tracks: JointTracks, child: int, path: str, notes: list[Note]) -> JointTracks:
    """Tracks whose root is a child of the former root; its motion is the product of both."""
    name, kept = tracks.names[child], tracks.below(child)
    others = [tracks.names[joint] for joint in np.setdiff1d(np.arange(1, len(tracks.names)), kept)]
    listed = ", ".join(f"'{other}'" for other in others[:4]) + ("" if len(others) <= 4 else ", …")
    if len(others) > _LEFT_OUT * (len(tracks.names) - 1):
        raise MotionFileError(
            path,
            tracks.places[child],
            f"a moving joint '{name}' on which the body hangs, or constant positions",
            f"{len(others)} joints beside it on '{tracks.names[0]}': {listed}",
            f"hang them on '{name}', or remove the position channels of '{name}'",
        )
    notes.append(Note("folded", tracks.names[0], f"joint '{tracks.names[0]}' is folded into '{name}', the new root"))
    if others:
        text = f"{len(others)} joints that hang on '{tracks.names[0]}' beside '{name}' are left out: {listed}"
        notes.append(Note("left_out", tracks.names[0], text, float(len(others))))
    place = np.full(len(tracks.names), -1)
    place[kept] = np.arange(len(kept))
    ground, rotations = tracks.rotations[:, 0], tracks.rotations[:, kept]
    rotations[:, 0] = quat.mul(ground, rotations[:, 0])
    positions = {int(place[joint]): track for joint, track in tracks.positions.items() if place[joint] > 0}
    positions[0] = tracks.local(0) + quat.rotate(ground, tracks.local(child))
    parents = place[tracks.parents[kept]]
    parents[0] = -1
    tips = place[tracks.tip_parents] >= 0
    return replace(
        tracks,
        names=tuple(tracks.names[joint] for joint in kept),
        parents=parents.astype(np.int64),
        offsets=tracks.offsets[kept],
        rotations=rotations,
        positions=positions,
        tip_parents=place[tracks.tip_parents[tips]].astype(np.int64),
        tip_offsets=tracks.tip_offsets[tips],
        places=[tracks.places[joint] for joint in kept],
    )


def _fixed(tracks: JointTracks, joint: int, path: str, stretch_m: float, notes: list[Note]) -> F64:
    """The offset (3,) that stands for a joint's animated positions."""
    name, track = tracks.names[joint], tracks.positions[joint]
    if float(np.ptp(track, axis=0).max()) <= _STILL_M:
        if not np.allclose(track[0], tracks.offsets[joint], rtol=0.0, atol=_STILL_M):
            notes.append(Note("offset", name, f"constant positions of joint '{name}' replace its offset"))
        return np.asarray(track[0])
    stretch, frame = _deviation(tracks, joint)
    if stretch > stretch_m:
        folded = f"make it the root (root = '{name}'), " * int(tracks.parents[joint] == 0)
        raise MotionFileError(
            path,
            tracks.places[joint],
            f"joint '{name}' within {1000.0 * stretch_m:g} mm of its mean offset (stretch_m)",
            f"{1000.0 * stretch:.1f} mm at frame {frame}",
            f"{folded}allow more with stretch_m, or remove its position channels where the file was made",
        )
    text = f"joint '{name}' stretches by up to {1000.0 * stretch:.2f} mm (frame {frame}); its mean offset is kept"
    notes.append(Note("stretch" if stretch > ROUNDING_M else "offset", name, text, stretch))
    return np.asarray(track.mean(axis=0))
