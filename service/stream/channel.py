"""How a channel is described to its client."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from service.stream.session import Channel
from service.wire import offsets_in

__all__ = ["opened"]


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
