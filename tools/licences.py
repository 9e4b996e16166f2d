"""Licences of the packages that the image and the page contain: ``python -m tools.licences`` writes docs/licences.md.

Python packages are those of requirements.runtime.lock, with the licence of their installed metadata; those of the page
are in package-lock.json, which has their licences.
"""

from __future__ import annotations

import json
import re
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

__all__ = ["PATH", "locked", "page_packages", "text"]

PROJECT = Path(__file__).parents[1]
PATH = PROJECT / "docs" / "licences.md"

ELSEWHERE = {"colorama": "BSD-3-Clause"}
"""Packages of other platforms, which are not installed on Linux."""

HEAD = """# Licences

Packages that the image and the page contain, from their locks; `make licences` writes this file. Adverb itself is under
the MIT licence. Wheels also contain libraries of their own, such as OpenBLAS in NumPy and SciPy, LLVM in llvmlite and
libpq in psycopg; their licences are in the `*.dist-info` folders of the installed packages.
"""


def locked() -> list[tuple[str, str]]:
    """Name and version of each Python package of the image; several versions where they depend on Python's."""
    lock = (PROJECT / "requirements.runtime.lock").read_text(encoding="utf-8")
    return sorted(re.findall(r"^([a-z0-9][\w.-]*)(?:\[[^\]]*\])?==([^\s;\\]+)", lock, re.MULTILINE))


def page_packages() -> dict[str, tuple[str, str]]:
    """Version and licence of each package of the page, without those that only build it."""
    lock = json.loads((PROJECT / "clients" / "dashboard" / "package-lock.json").read_text(encoding="utf-8"))
    rows = {name.rpartition("node_modules/")[2]: row for name, row in lock["packages"].items() if name}
    return {name: (row["version"], row["license"]) for name, row in rows.items() if not row.get("dev")}


def licence(name: str) -> str:
    """Licence of a Python package: its expression, else its classifiers, else the first line of its licence field.

    Raises
    ------
    LookupError
        The package is not installed, or names no licence.
    """
    if name in ELSEWHERE:
        return ELSEWHERE[name]
    try:
        found = metadata(name)
    except PackageNotFoundError:
        raise LookupError(f"{name} is not installed; run `make setup`") from None
    classifiers = [
        row.rpartition(" :: ")[2] for row in found.get_all("Classifier") or [] if row.startswith("License ::")
    ]
    field = _first(found.get_all("License")).strip().splitlines()
    answer = _first(found.get_all("License-Expression")) or ", ".join(classifiers) or (field[0] if field else "")
    if not answer:
        raise LookupError(f"{name} names no licence")
    return answer


def _first(values: list[str] | None) -> str:
    return values[0] if values else ""


def text() -> str:
    """Content of docs/licences.md."""
    python = [f"| {name} | {version} | {licence(name)} |" for name, version in locked()]
    page = [f"| {name} | {version} | {found} |" for name, (version, found) in sorted(page_packages().items())]
    head = ["| package | version | licence |", "| --- | --- | --- |"]
    return "\n".join([HEAD, "## Image", "", *head, *python, "", "## Page", "", *head, *page, ""])


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
