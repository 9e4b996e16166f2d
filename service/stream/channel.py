"""Channels and groups: a channel is one client's view of a character; a group is a verb with its characters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from service.catalog.catalog import Entry
from service.stream.messages import Open
from service.stream.packing import Layout, offsets_in
from verbs.runtime.characters import Characters

if TYPE_CHECKING:
    from service.stream.session import Session

__all__ = ["Channel", "Group", "layout_of", "opened"]

NEW_VERSION = 4


class Group:
    """The characters of one version of a verb, blended by one method.

    Parameters
    ----------
    entry : Entry
    method : str
    """

    def __init__(self, entry: Entry, method: str) -> None:
        self.entry = entry
        self.characters = Characters(entry.evaluator, method)

    @property
    def key(self) -> tuple[str, int, str]:
        """Verb, version and method."""
        return self.entry.verb.name, self.entry.version, self.characters.method


@dataclass(slots=True, eq=False)
class Channel:
    """One character as one client sees it.

    Parameters
    ----------
    number : int
        The client's own.
    session : Session
    group : Group
    slot : int
        Its character in the group.
    fps : int
    layout : Layout
    asked : Open
        How it was opened: what `switch` keeps.
    flags : int
        Bits that its next record carries beside those of its frame.
    """

    number: int
    session: Session = field(repr=False)
    group: Group = field(repr=False)
    slot: int
    fps: int
    layout: Layout
    asked: Open
    flags: int = 0

    def head(self) -> int:
        """First word of its record, without encoding and what the frame tells."""
        return self.number | self.flags << 24


def layout_of(entry: Entry, asked: Open) -> Layout:
    """How records are written; raises :class:`UnknownName` for a joint that does not exist."""
    joints = entry.joints(asked.joints)
    if joints is None:
        joints = np.arange(len(entry.verb.skeleton))
    return Layout(asked.encoding, asked.space, asked.frame, joints, len(entry.verb.examples))


def opened(channel: Channel, *, resumed: bool = False) -> dict[str, Any]:
    """What the client needs to know in order to read the channel's records."""
    entry, layout = channel.group.entry, channel.layout
    verb, skeleton, characters = entry.verb, entry.verb.skeleton, channel.group.characters
    return {
        "op": "opened",
        "channel": channel.number,
        "verb": verb.name,
        "version": entry.version,
        "method": characters.method,
        "skeleton": {
            "names": skeleton.names,
            "parents": skeleton.parents,
            "offsets": offsets_in(skeleton, layout.frame),
        },
        "adverbs": [
            {
                "name": adverb.name,
                "unit": adverb.unit,
                "min": adverb.minimum,
                "max": adverb.maximum,
                "style": adverb.style,
                "goal": goal,
            }
            for adverb, goal in zip(verb.adverbs, characters.asked[channel.slot].tolist(), strict=True)
        ],
        "joints": _named(skeleton.names, layout.joints.tolist()),
        "encoding": layout.encoding,
        "space": layout.space,
        "frame": layout.frame,
        "fps": channel.fps,
        "looping": verb.looping,
        "keytimes": [
            {"name": name, "phase": phase} for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True)
        ],
        "follow": characters.window,
        "record_bytes": 4 * layout.words,
        "resumed": resumed,
    }


def _named(names: tuple[str, ...], indices: Iterable[int]) -> list[str]:
    return [names[index] for index in indices]
