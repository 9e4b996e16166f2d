"""Captured sources with other measures: the clips stay, the adverbs are declared anew."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import numpy as np

from verbs.authoring.toml_text import toml_dump

__all__ = ["redeclare"]

DROPPED = ("measure", "effector", "effector_keytime_index", "goal", "tetrahedra", "simplices")


def redeclare(source: Path, folder: Path, adverbs: list[dict], *, values=None, **more) -> Path:
    """Copy a source with other ``[[adverb]]`` tables.

    Stored values (N, D) are random where none are given: a build measures them anew.
    """
    shutil.copytree(source, folder)
    table = tomllib.loads((folder / "verb.toml").read_text())
    table = {key: value for key, value in table.items() if key not in DROPPED} | more
    table["adverb"] = adverbs
    stored = np.random.default_rng(0).normal(size=(len(table["example"]), len(adverbs))) if values is None else values
    for row, own in zip(table["example"], stored, strict=True):
        row["adverb_values"] = [float(number) for number in own]
    (folder / "verb.toml").write_text(toml_dump(table))
    return folder


def positions(joint: str, at: str, *, prefix: str = "", unit: str = "m") -> list[dict]:
    """Adverbs for the coordinates of a joint."""
    return [
        {"name": f"{prefix}{axis}", "unit": unit,
         "measure": {"kind": "position", "joint": joint, "axis": axis, "at": at}}
        for axis in "xyz"
    ]  # fmt: skip
