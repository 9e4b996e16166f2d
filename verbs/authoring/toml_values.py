"""Values of a ``verb.toml``: bounded parsing, checks of all values, and those that are kept without a meaning."""

from __future__ import annotations

import re
import tomllib
from datetime import date, time
from math import isfinite
from pathlib import Path
from typing import Any

from verbs.errors import SourceError

__all__ = ["check", "kept", "load"]

MAX_TOML_BYTES = 4 * 1024 * 1024
MAX_DEPTH = 32

_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""", re.ASCII)
"""More than :data:`MAX_DEPTH` parts of a dotted key, which cost :mod:`tomllib` quadratic time; it never backtracks."""


def load(path: Path) -> dict[str, Any]:
    """Parse a file of bounded size; raises :class:`SourceError`."""
    try:
        size = path.stat().st_size
        if size > MAX_TOML_BYTES:
            raise SourceError(path, f"{size} bytes; a verb.toml has at most {MAX_TOML_BYTES}")
        text = path.read_text("utf-8-sig")
        if _LONG_KEY.search(text):
            raise SourceError(path, f"a key has more than {MAX_DEPTH} parts")
        return tomllib.loads(text)
    except FileNotFoundError:
        raise SourceError(path, "not found; a verb source is a folder with a verb.toml and its motion files") from None
    except NotADirectoryError:
        raise SourceError(path.parent, "is a file; name the folder that holds verb.toml") from None
    except OSError as err:
        raise SourceError(path, f"cannot be read: {err.strerror or err}") from err
    except (ValueError, RecursionError) as err:  # TOML, UTF-8, or a number of thousands of digits
        raise SourceError(path, f"is not valid TOML: {err}") from err


def check(path: Path, table: dict[str, Any]) -> None:
    """Refuse integers beyond 64 bits, which TOML does not have, and deep nesting; raises :class:`SourceError`."""
    level: list[Any] = [table]
    for _ in range(MAX_DEPTH):
        level = [
            inner
            for value in level
            if isinstance(value, (dict, list))
            for inner in (value.values() if isinstance(value, dict) else value)
        ]
        if any(isinstance(value, int) and not -(1 << 63) <= value < 1 << 63 for value in level):
            raise SourceError(path, "an integer does not fit into 64 bits")
        if not level:
            return
    raise SourceError(path, f"tables and lists are nested more than {MAX_DEPTH} deep")


def kept(path: Path, key: str, value: Any) -> Any:
    """A value without a meaning here, as JSON can hold it: dates and times as text."""
    if isinstance(value, dict):
        return {name: kept(path, key, inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [kept(path, key, inner) for inner in value]
    if isinstance(value, float) and not isfinite(value):
        raise SourceError(path, f"key '{key}' holds {value}; numbers must be finite")
    return value.isoformat() if isinstance(value, (date, time)) else value
