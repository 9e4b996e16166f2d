"""What to do about a clip that cannot be blended with others."""

from __future__ import annotations

from verbs.clips import placement, spins
from verbs.clips.reports import toml_text
from verbs.motion import Motion

__all__ = ["turn_advice"]


def turn_advice(motion: Motion, joint: int, example: str) -> str:
    """What to do about a joint of an example that rotates too far from the mean to be blended."""
    found = spins.find(motion, [joint]) if joint else placement.find_heading(motion)
    if found:
        problem = "it spins; unwind it" if joint else "it faces another way; rotate it"
        return f"{problem} in verb.toml with\n{toml_text(found[0].mend, example)}"
    return "check its keytimes, or leave it out"
