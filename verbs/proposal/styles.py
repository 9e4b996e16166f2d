"""Style adverbs of clips: from a CSV file, or from the names of the files by a pattern."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from verbs.errors import SourceError
from verbs.proposal.cycles import CUT

__all__ = ["MAX_CSV_BYTES", "from_csv", "from_pattern", "styles_of"]

MAX_CSV_BYTES = 4 * 1024 * 1024

_FIELD = re.compile(r"\{(\w*)(?::(float|text))?\}")
_NUMBER = r"[+-]?\d+(?:\.\d+)?"

Styles = dict[str, dict[str, float]]
"""Values of the style adverbs by file name."""


def styles_of(names: Sequence[str], style_csv: Path | None, pattern: str | None) -> Styles:
    """Style adverbs of files from a CSV file and a pattern; empty without both.

    A file that was cut from another has the adverbs of that one.

    Raises
    ------
    SourceError
        If a file has none.
    """
    found: Styles = {}
    originals = {name: name.replace(CUT, "") for name in names}
    tables = [(style_csv, from_csv(style_csv))] if style_csv else []
    if pattern:
        tables.append((Path(pattern), from_pattern(pattern, [*names, *originals.values()])))
    for where, table in tables:
        for name, original in originals.items():
            keys = (name, original, Path(name).stem, Path(original).stem)
            own = next((table[key] for key in keys if key in table), None)
            if own is None:
                raise SourceError(where, f"has no style adverbs for '{name}'; add it, or leave the clip out")
            found.setdefault(name, {}).update(own)
    return found


def from_csv(path: Path) -> Styles:
    """Style adverbs of a CSV file with the header ``file,NAME,…``; a file may be named without its ending.

    Raises
    ------
    SourceError
        Naming the line and what is wrong.
    """
    try:
        if path.stat().st_size > MAX_CSV_BYTES:
            raise SourceError(path, f"is larger than {MAX_CSV_BYTES} bytes")
        rows = list(csv.reader(path.read_text("utf-8-sig").splitlines()))
    except (OSError, ValueError, csv.Error) as err:
        raise SourceError(path, f"cannot be read as CSV: {err}") from err
    if not rows or rows[0][:1] != ["file"] or len(rows[0]) < 2:
        raise SourceError(path, "line 1 must be 'file,NAME,…' with the names of the style adverbs")
    names = [name.strip() for name in rows[0][1:]]
    for name in names:
        _check_name(path, name)
    found: Styles = {}
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            values = [float(cell) for cell in row[1:]]
        except ValueError:
            values = []
        if len(values) != len(names) or not all(abs(value) <= 1e9 for value in values):
            raise SourceError(path, f"line {line} needs a file and {len(names)} numbers")
        found[row[0].strip()] = dict(zip(names, values, strict=True))
    return found


def from_pattern(pattern: str, names: Sequence[str]) -> Styles:
    """Style adverbs of file names, such as ``walk_0.5_2.bvh`` by ``{}_{tired:float}_{}.bvh``.

    ``{NAME:float}`` is a number and becomes an adverb; ``{NAME}`` is text and becomes none; ``{}`` is any text.

    Raises
    ------
    SourceError
        If the pattern has no number, repeats a name, or has a name that an adverb cannot have.
    """
    expression, at, adverbs = "", 0, []
    for match in _FIELD.finditer(pattern):
        expression += re.escape(pattern[at : match.start()])
        at = match.end()
        if match[2] == "float":
            _check_name(Path(pattern), match[1])
            adverbs.append(match[1])
            expression += f"({_NUMBER})"
        else:
            expression += "[^/]*?"
    expression += re.escape(pattern[at:])
    if not adverbs or len(set(adverbs)) < len(adverbs):
        raise SourceError(pattern, "needs numbers of different names, e.g. '{}_{tired:float}.bvh'")
    found: Styles = {}
    for name in names:
        hit = re.fullmatch(expression, name) or re.fullmatch(expression, Path(name).stem)
        if hit:
            found[name] = {adverb: float(value) for adverb, value in zip(adverbs, hit.groups(), strict=True)}
    return found


def _check_name(path: Path, name: str) -> None:
    if not name.isidentifier() or len(name) > 63:
        raise SourceError(path, f"'{name}' cannot name an adverb: use letters, digits and '_', no digit first")
