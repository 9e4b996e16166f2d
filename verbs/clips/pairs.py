"""Left and right joints of a skeleton, paired by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.conventions import I64
from verbs.errors import OutOfRange
from verbs.skeleton import Skeleton

__all__ = ["Pairs", "find_pairs", "mirrored_name"]

_FORMS = (
    (re.compile(r"Left|Right"), {"Left": "Right", "Right": "Left"}),
    (re.compile(r"(?<![A-Za-z])(?:left|right)"), {"left": "right", "right": "left"}),
    (re.compile(r"LEFT|RIGHT"), {"LEFT": "RIGHT", "RIGHT": "LEFT"}),
    (re.compile(r"(?:(?<=[_.\-: ])|^)[lLrR](?=[_.\-: ]|$)"), {"l": "r", "r": "l", "L": "R", "R": "L"}),
    (re.compile(r"(?:(?<=[:_])|^)[lLrR](?=[A-Z])"), {"l": "r", "r": "l", "L": "R", "R": "L"}),
    (re.compile(r"(?<=[a-z])(?:Lf|Rt|[LR])(?=$|[_.\d])"), {"L": "R", "R": "L", "Lf": "Rt", "Rt": "Lf"}),
)
"""Forms in which names state a side, the most explicit first, and what each becomes on the other side."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Partner of each joint.

    Parameters
    ----------
    partner : (J,) int64
        The joint on the other side; a joint of the middle is its own.
    unmatched : tuple of str
        Joints without a partner that need one: their names state a side, or they hang on a joint of one side. They
        are their own.
    """

    partner: I64
    unmatched: tuple[str, ...]


def mirrored_name(name: str) -> str | None:
    """A joint's name with its side exchanged; None where it states no side.

    Examples
    --------
    >>> mirrored_name("LeftHand"), mirrored_name("l_wrist"), mirrored_name("hand.R"), mirrored_name("Spine")
    ('RightHand', 'r_wrist', 'hand.L', None)
    """
    for form, swap in _FORMS:
        if form.search(name):
            return form.sub(lambda found, swap=swap: swap[found.group()], name)  # type: ignore[misc]
    return None


def find_pairs(skeleton: Skeleton, table: Mapping[str, str] | None = None) -> Pairs:
    """Pair the joints of a skeleton.

    Parameters
    ----------
    skeleton : Skeleton
    table : mapping of str to str, optional
        Pairs that names do not show, in either direction; they go before the names.

    Raises
    ------
    UnknownName
        The table names a joint that does not exist.
    OutOfRange
        The table pairs a joint twice, or paired joints do not hang on paired parents.
    """
    count = len(skeleton)
    partner = np.full(count, -1, np.int64)
    for one, other in (table or {}).items():
        first, second = skeleton.index(one), skeleton.index(other)
        for joint, mate in ((first, second), (second, first)):
            if partner[joint] not in (-1, mate):
                raise OutOfRange(f"joint '{skeleton.names[joint]}' has two partners in the table of pairs")
            partner[joint] = mate
    loose: list[int] = []
    for joint, name in enumerate(skeleton.names):
        if partner[joint] >= 0:
            continue
        opposite = mirrored_name(name)
        mate = skeleton.names.index(opposite) if opposite in skeleton.names else joint
        if partner[mate] >= 0:
            mate = joint
        partner[joint], partner[mate] = mate, joint
        above = skeleton.parents[joint]
        if mate == joint and (opposite is not None or (joint and partner[above] != above) or above in loose):
            loose.append(joint)
    for joint in range(1, count):
        mate = partner[joint]
        if joint not in loose and partner[skeleton.parents[joint]] != skeleton.parents[mate]:
            raise OutOfRange(
                f"joints '{skeleton.names[joint]}' and '{skeleton.names[mate]}' cannot be mirrored: their parents "
                f"'{skeleton.names[skeleton.parents[joint]]}' and '{skeleton.names[skeleton.parents[mate]]}' are no "
                "pair; name the pairs in a table"
            )
    return Pairs(partner, tuple(skeleton.names[joint] for joint in loose))
