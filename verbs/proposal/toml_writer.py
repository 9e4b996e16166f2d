"""The text of a proposed ``verb.toml``: complete, with the evidence and confidence beside each value."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from verbs.clips.reports import Mend
from verbs.clips.reports import toml_text as mend_table
from verbs.proposal.keytimes import Keytimes

__all__ = ["Head", "Row", "toml_text"]

LOW = 0.5
"""Keytimes of lower confidence are marked."""


@dataclass(frozen=True, slots=True)
class Row:
    """One ``[[example]]``: file, keytimes, adverb values, remarks; ``excluded`` is the reason or empty.

    ``keytimes`` are seconds of the mended clip, which begins at ``start_s`` of its file.
    """

    file: str
    keytimes: Keytimes
    values: tuple[float, ...]
    remarks: tuple[str, ...] = ()
    excluded: str = ""
    mends: tuple[Mend, ...] = ()
    start_s: float = 0.0

    @property
    def marks(self) -> tuple[float, ...]:
        """Keytimes in seconds of the file."""
        return tuple(self.start_s + time for time in self.keytimes.times)


@dataclass(frozen=True, slots=True)
class Head:
    """Everything before the examples; ``evidence`` are comments by key, adverbs (name, unit, description, style)."""

    name: str
    description: str
    looping: bool
    measure: str
    effector: str
    effector_keytime: int
    keytime_names: tuple[str, ...]
    unit: str
    adverbs: tuple[tuple[str, str, str, bool], ...]
    evidence: dict[str, str] = field(default_factory=dict)
    up: str = "+Y"
    forward: str = "+Z"


def toml_text(head: Head, rows: Sequence[Row], unreadable: Sequence[str]) -> str:
    """The text of a verb.toml; ``unreadable`` are sentences about files without a row."""
    why = head.evidence
    lines = [
        "# Proposed by `adverb init`. Check the lines marked 'check' first, then run `adverb build` on this folder.",
        "",
        f"name = {_quoted(head.name)}",
        f"description = {_quoted(head.description)}",
        f"looping = {str(head.looping).lower()}",
        *(
            [f"effector = {_quoted(head.effector)}  # {_comment(why.get('effector', 'given'))}"]
            if head.effector
            else []
        ),
        f"effector_keytime_index = {head.effector_keytime}",
        f'measure = "{head.measure}"  # {_comment(why.get("measure", "given"))}',
        f"keytime_names = {json.dumps(list(head.keytime_names), ensure_ascii=False)}"
        f"  # {_comment(why.get('keytimes', ''))}",
        *([f"# chart: {_comment(why['chart'])}"] if why.get("chart") else []),
        *([f"# domain: {_comment(why['domain'])}"] if why.get("domain") else []),
        f'up_axis = "{head.up}"' + (f"  # {_comment(why['axes'])}" if why.get("axes") else ""),
        f'forward_axis = "{head.forward}"',
        "",
        "[units]",
        f'length = "{head.unit}"  # {_comment(why.get("unit", "given"))}',
    ]
    for name, unit, description, style in head.adverbs:
        lines += ["", "[[adverb]]", f"name = {_quoted(name)}", f'unit = "{unit}"',
                  f"description = {_quoted(description)}", *["style = true"] * style]  # fmt: skip
    for row in rows:
        if not row.excluded:
            lines += ["", *_row(row, head.keytime_names)]
    for row in rows:
        for mend in row.mends:
            lines += ["", *mend_text(mend, Path(row.file).stem, commented=bool(row.excluded))]
    if unreadable or any(row.excluded for row in rows):
        lines += ["", "# Excluded clips. Mend one, then remove the '#' before its lines, or run `adverb init` again."]
    for row in rows:
        if row.excluded:
            commented = (f"# {line}" for line in _row(row, head.keytime_names))
            lines += ["#", f"# {row.file}: {_comment(row.excluded)}", *commented]
    lines += [f"# {_comment(sentence)}" for sentence in unreadable]
    return "\n".join(lines) + "\n"


def mend_text(mend: Mend, example: str, *, commented: bool) -> list[str]:
    """Lines of a [[mend]] table."""
    return [f"# {line}" if commented else line for line in mend_table(mend, example).splitlines()]


def _row(row: Row, names: tuple[str, ...]) -> list[str]:
    marks = row.keytimes
    lines = ["[[example]]", f"file = {_quoted(row.file)}"]
    lines += [f"# {_comment(remark)}" for remark in row.remarks]
    for name, sure, why in zip(names, marks.confidence, marks.evidence, strict=True):
        if sure < 1.0:
            lines.append(f"# {name}: confidence {sure:.2f}{', check' * (sure < LOW)} ({_comment(why)})")
    lines.append(f"keytimes = [{', '.join(f'{time:.5f}' for time in row.marks)}]")
    lines.append(f"adverb_values = [{', '.join(f'{value + 0.0:.5f}' for value in row.values)}]")
    return lines


def _quoted(text: str) -> str:
    """A TOML basic string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(text: str) -> str:
    """Text that stays on the line of its comment."""
    return "".join(letter if letter.isprintable() else " " for letter in text)
