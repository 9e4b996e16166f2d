"""Options of a proposal, and the proposal itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from verbs.authoring.fit import Assembled
from verbs.proposal.clips import Refused
from verbs.proposal.cycles import Cut
from verbs.proposal.toml_writer import Head, Row

__all__ = ["Options", "Proposal"]


@dataclass(frozen=True, slots=True)
class Options:
    """What the author states; the rest is guessed.

    Parameters
    ----------
    effector, measure, unit, name : str or None
    annotated : mapping of str to tuple of float
        Keytimes, seconds, by file name.
    keytime_names : tuple of str
        Names for annotated keytimes; empty for usual ones.
    style_csv : Path or None
    pattern : str or None
    """

    effector: str | None = None
    measure: str | None = None
    unit: str | None = None
    name: str | None = None
    annotated: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    keytime_names: tuple[str, ...] = ()
    style_csv: Path | None = None
    pattern: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A proposed source.

    Parameters
    ----------
    text : str
        Of verb.toml.
    head : Head
    rows : tuple of Row
        Clips that were measured, the excluded ones among them.
    refused : tuple of Refused
        Files that could not be.
    cuts : mapping of str to Cut
        Cycles that were cut, by the name of the file to write.
    verb : Assembled or None
        The verb of the proposal, with fewer samples than a build has; None where it would not build yet.
    problem : str
        Why it would not.
    left_out_deg : mapping of str to float
        Mean joint angle between a clip and its prediction from the others.
    """

    text: str
    head: Head
    rows: tuple[Row, ...]
    refused: tuple[Refused, ...]
    cuts: Mapping[str, Cut]
    verb: Assembled | None
    problem: str
    left_out_deg: Mapping[str, float]

    def report(self) -> dict[str, Any]:
        """The proposal as JSON."""
        names = [name for name, *_ in self.head.adverbs]
        kept = [row for row in self.rows if not row.excluded]
        return {
            "name": self.head.name,
            "measure": self.head.measure,
            "effector": self.head.effector or None,
            "looping": self.head.looping,
            "unit": self.head.unit,
            "keytime_names": list(self.head.keytime_names),
            "evidence": dict(self.head.evidence),
            "adverbs": [{"name": n, "unit": u, "style": style} for n, u, _, style in self.head.adverbs],
            "clips": [
                {
                    "file": row.file,
                    "keytimes": list(row.marks),
                    "confidence": list(row.keytimes.confidence),
                    "evidence": list(row.keytimes.evidence),
                    "adverbs": dict(zip(names, row.values, strict=True)),
                    "left_out_deg": self.left_out_deg.get(row.file),
                    "remarks": list(row.remarks),
                }
                for row in kept
            ],
            "excluded": [{"file": row.file, "problem": row.excluded, "advice": "remove the '#' before its lines"}
                         for row in self.rows if row.excluded]
            + [{"file": odd.name, "problem": odd.problem, "advice": odd.advice} for odd in self.refused],
            "left_out_mean_deg": float(np.mean(list(self.left_out_deg.values()))) if self.left_out_deg else None,
            "builds": self.verb is not None,
            "problem": self.problem or None,
        }  # fmt: skip
