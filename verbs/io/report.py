"""What reading a motion file gives: the motion, and a report of everything that was changed or left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from verbs.conventions import F64, freeze
from verbs.motion import Motion

__all__ = ["CHANGES", "Folded", "Marks", "MotionFile", "Note", "NoteKind", "Report"]

NoteKind = Literal["folded", "left_out", "offset", "stretch", "ignored_root", "ignored_channels", "scale", "applied"]
"""What a note is about.

``folded`` a moving joint was multiplied into its parent; ``left_out`` joints beside it are missing; ``offset`` constant
positions, but for rounding, became an offset; ``stretch`` small changes of length were dropped; ``ignored_root``
another hierarchy; ``ignored_channels`` channels without effect on the pose; ``scale`` scales of joints; ``applied`` the
transform of nodes above the root.
"""

CHANGES: tuple[NoteKind, ...] = ("folded", "left_out", "stretch", "ignored_root", "scale")
"""Kinds that change what the file shows, or leave a part of it out; a build repeats them as warnings."""


@dataclass(frozen=True, slots=True)
class Note:
    """One finding.

    Parameters
    ----------
    kind : NoteKind
    subject : str
        The joint or node.
    text : str
        A sentence without its full stop.
    amount : float
        Size of the finding: metres for ``stretch``, a number of joints for ``left_out`` and ``ignored_root``, else 0.
    """

    kind: NoteKind
    subject: str
    text: str
    amount: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Folded:
    """The own motion of a joint that was folded into its child, in the space of the file.

    Parameters
    ----------
    name : str
    positions : (F, 3) float64
        Metres.
    rotations : (F, 4) float64
        Global rotations, unit quaternions.
    """

    name: str
    positions: F64
    rotations: F64

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Contacts that a file states.

    Parameters
    ----------
    names : tuple of str, length P
        Points in contact: names of joints.
    values : (F, P) float64
        1 where a point is in contact, 0 where it is not, or a likelihood between them.
    """

    names: tuple[str, ...]
    values: F64

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """How a motion was read.

    Parameters
    ----------
    format : str
        ``bvh``, ``gltf`` or ``npz``.
    notes : tuple of Note
    folded : tuple of Folded
        Joints above the root of the motion, the outermost first: heading and travel of a root-motion rig.
    clips : tuple of str
        Names of all animations in the file; one empty name where the format holds a single motion.
    clip : int
        Which of them was read.
    contacts : Marks or None
    """

    format: str
    notes: tuple[Note, ...] = ()
    folded: tuple[Folded, ...] = ()
    clips: tuple[str, ...] = ("",)
    clip: int = 0
    contacts: Marks | None = field(default=None)

    def of(self, kind: NoteKind) -> tuple[Note, ...]:
        """Notes of one kind."""
        return tuple(note for note in self.notes if note.kind == kind)

    @property
    def changes(self) -> tuple[str, ...]:
        """Texts of the notes that change what the file shows."""
        return tuple(note.text for note in self.notes if note.kind in CHANGES)


@dataclass(frozen=True, slots=True, eq=False)
class MotionFile:
    """A motion and the report of how it was read."""

    motion: Motion
    report: Report
