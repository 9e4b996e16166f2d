"""A mend of a clip, and the report on it: where, what was found, what is done, with a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from verbs.errors import OutOfRange

__all__ = ["Mend", "Report", "toml_text"]


@dataclass(frozen=True, slots=True)
class Mend:
    """One mend of a clip.

    Parameters
    ----------
    kind : str
        A name of :data:`verbs.clips.mends.KINDS`.
    joint : str, optional
        The joint that is mended; by default every joint where the kind finds something.
    start_s, end_s : float, optional
        Seconds of the file. A mend with both acts on that stretch, whether something is found there or not.
    options : mapping of str to float
        Parameters of the kind, such as ``cutoff_hz``; see :data:`verbs.clips.mends.KINDS`.
    """

    kind: str
    joint: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    options: Mapping[str, float] = field(default_factory=dict)

    @property
    def stretch(self) -> tuple[float, float] | None:
        """Start and end in seconds where the mend names both; None where it names neither.

        Raises
        ------
        OutOfRange
            One without the other, or an end before its start.
        """
        if self.start_s is None and self.end_s is None:
            return None
        if self.start_s is None or self.end_s is None or self.end_s < self.start_s:
            raise OutOfRange(f"a mend of kind '{self.kind}' needs both start and end, the end not before the start")
        return self.start_s, self.end_s


@dataclass(frozen=True, slots=True)
class Report:
    """What is wrong in a clip and what its mend does.

    Parameters
    ----------
    mend : Mend
        The mend of exactly this finding.
    found, done : str
        Sentences without a full stop.
    figure : float
        Size of the fault, or of the change, in ``unit``.
    unit : str
        ``"deg"``, ``"mm"`` or ``"s"``.
    proposed : bool
        False for what is only reported: no mend without the author's decision.
    """

    mend: Mend
    found: str
    done: str
    figure: float
    unit: str
    proposed: bool = True

    def row(self) -> dict[str, Any]:
        """The report as plain values, as the provenance of a verb keeps it."""
        mend = self.mend
        place = {"joint": mend.joint, "start": mend.start_s, "end": mend.end_s}
        shown = {key: value for key, value in place.items() if value is not None}
        rest = {"found": self.found, "done": self.done, "figure": round(self.figure, 4) + 0.0, "unit": self.unit}
        return {"kind": mend.kind, **shown, **mend.options, **rest}


def toml_text(mend: Mend, example: str) -> str:
    """The ``[[mend]]`` table of a mend, ready to be copied into ``verb.toml``."""
    rows: list[tuple[str, object]] = [("kind", mend.kind), ("example", example)]
    rows += [("joint", mend.joint), ("start", mend.start_s), ("end", mend.end_s), *mend.options.items()]
    lines = [f"{key} = {_value(value)}" for key, value in rows if value is not None]
    return "\n".join(["[[mend]]", *lines])


def _value(value: object) -> str:
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return repr(round(float(value), 7)) if isinstance(value, (int, float)) else str(value)
