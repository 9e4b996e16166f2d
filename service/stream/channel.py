"""How a channel is described to its client, and how its records are laid out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from service.catalog.catalog import Entry
from service.stream.messages import Open
from service.stream.session import Channel
from service.wire import Layout, offsets_in

__all__ = ["layout_of", "opened"]


def layout_of(entry: Entry, request: Open) -> Layout:
    """Layout of the records; raises :class:`UnknownName` for a joint that does not exist."""
    joints = entry.joints(request.joints)
    if joints is None:
        joints = np.arange(len(entry.verb.skeleton))
    return Layout(request.encoding, request.space, request.frame, joints, len(entry.verb.examples))


def opened(channel: Channel, *, resumed: bool = False) -> dict[str, Any]:
    """The message ``opened``: what a client needs to read the channel's records."""
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
            for adverb, goal in zip(verb.adverbs, characters.goals[channel.slot].tolist(), strict=True)
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
