"""Write a table as TOML: what :mod:`tomllib` reads comes back equal; comments and layout are not kept."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping
from typing import Any

__all__ = ["toml_dump"]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def toml_dump(table: Mapping[str, Any]) -> str:
    """The text of a table: plain values first, then ``[tables]``, then ``[[arrays of tables]]``."""
    plain = {key: value for key, value in table.items() if not _is_table(value) and not _is_tables(value)}
    lines = _rows(plain)
    for key, value in table.items():
        if _is_table(value):
            lines += ["", f"[{_key(key)}]", *_rows(value)]
    for key, value in table.items():
        for row in value if _is_tables(value) else []:
            lines += ["", f"[[{_key(key)}]]", *_rows(row)]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(row, Mapping) for row in value)


def _rows(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items()]


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    shown = "".join(_ESCAPES.get(c, c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}") for c in text)
    return f'"{shown}"'


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_rows(value)) + " }" if value else "{}"
    if isinstance(value, (datetime.date, datetime.time)):
        return value.isoformat()
    return "[" + ", ".join(_value(item) for item in value) + "]"
