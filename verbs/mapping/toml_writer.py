"""Write a ``mapping.toml``."""

from __future__ import annotations

from collections.abc import Mapping as Table
from typing import Any

from verbs.authoring.toml_text import toml_dump
from verbs.mapping.mapping import Mapping
from verbs.mapping.presets import PRESETS

__all__ = ["to_toml"]


def to_toml(mapping: Mapping, joints: Table[str, str], target: str) -> str:
    """Text of a ``mapping.toml`` that states every joint, and those that the mapping leaves out.

    Parameters
    ----------
    mapping : Mapping
    joints : mapping of str to str
        Target joints by source joints; see :func:`verbs.mapping.plan.explicit_joints`.
    target : str
        Name of the preset, or path of the target from the folder of the ``mapping.toml``.
    """
    ground = {"feet": mapping.feet} | ({} if mapping.height is None else {"height": mapping.height})
    root = {} if mapping.root is None else {"joint": mapping.root}
    left_out = {source: "" for source, other in mapping.joints.items() if not other}
    head: dict[str, Any] = {"preset": target} if target in PRESETS else {"target": target, "unit": mapping.rig.unit}
    return toml_dump(
        head
        | {
            "root": root | {"scale": mapping.scale or "legs", "travel": mapping.travel or "scaled"},
            "ground": ground,
            "effector": {"goal": mapping.goal},
            "joints": {**joints, **left_out},
        }
    )
