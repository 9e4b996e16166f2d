"""How a channel is described to its client."""

from __future__ import annotations

from typing import Any

from service.stream.session import Channel

__all__ = ["opened"]


def opened(channel: Channel, *, resumed: bool = False) -> dict[str, Any]:
    """The message ``opened``: what a client needs to read the channel's records."""
    entry, layout = channel.group.entry, channel.layout
    verb, characters = entry.verb, channel.group.characters
    return {
        "op": "opened",
        "channel": channel.number,
        "verb": verb.name,
        "version": entry.version,
        "method": characters.method,
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
        "encoding": layout.encoding,
        "space": layout.space,
        "frame": layout.frame,
        "fps": channel.fps,
        "looping": verb.looping,
        **channel.group.described(layout),
        "follow": characters.window,
        "record_bytes": 4 * layout.words,
        "resumed": resumed,
    }
