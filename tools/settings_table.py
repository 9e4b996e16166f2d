"""Write the table of settings, ``docs/settings.md``: ``python -m tools.settings_table``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Any

from service.settings import Settings

__all__ = ["FILE", "text"]

FILE = Path(__file__).parents[1] / "docs" / "settings.md"

_HEAD = """# Settings

Environment variables of `adverb serve` and `adverb worker`. Most are also a flag of `adverb serve`; a flag wins over
its variable. An empty variable counts as not set. `make serve` passes them on.

| variable | default | meaning |
| --- | --- | --- |
"""


def text() -> str:
    """The file's content, made from the descriptions in :class:`service.settings.Settings`."""
    rows = (
        f"| `ADVERB_{name.upper()}` | {_default(field.default)} | {field.description} |\n"
        for name, field in Settings.model_fields.items()
    )
    return _HEAD + "".join(rows)


def _default(value: Any) -> str:
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value.value if isinstance(value, Enum) else value)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
