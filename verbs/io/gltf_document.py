"""The container of a glTF 2.0 file: JSON, binary chunk, buffers, and typed access with places for errors.

Source: Khronos, "glTF 2.0 Specification", sections 3.6 (buffers) and 4 (GLB).
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urlsplit

from verbs.conventions import MAX_FILE_BYTES
from verbs.errors import MotionFileError
from verbs.io.files import file_content

__all__ = ["Document", "Row", "open_document"]

Row = dict[str, Any]

MAX_JSON_BYTES = 64 * 1024 * 1024
MAX_ROWS = 100_000
"""Rows of one kind (nodes, accessors …); real files have some thousands."""

_LARGEST = 1e30
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_HEADER = struct.Struct("<III")
_CHUNK = struct.Struct("<II")


class Document:
    """A parsed file: rows of its JSON by kind, and the bytes of its buffers, which are loaded on first use."""

    def __init__(self, path: Path, table: Row, binary: bytes | None) -> None:
        self.path, self._table, self._binary = path, table, binary
        self._buffers: dict[int, memoryview] = {}
        self._loaded = 0

    @property
    def table(self) -> Row:
        """The whole JSON object."""
        return self._table

    @property
    def binary(self) -> bytes | None:
        """The binary chunk of a ``.glb`` file; None without one."""
        return self._binary

    def fail(self, place: str, expected: str, found: str, advice: str = "") -> NoReturn:
        """Raise a :class:`MotionFileError` for a place in the file."""
        raise MotionFileError(self.path, place, expected, found, advice)

    def rows(self, kind: str) -> list[Row]:
        """All rows of a kind; an empty list where there are none."""
        return self.rows_of(self._table, kind, kind)

    def rows_of(self, row: Row, key: str, place: str) -> list[Row]:
        """A list of objects inside a row."""
        found = row.get(key, [])
        if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
            self.fail(place, "a list of objects", shown(found))
        if len(found) > MAX_ROWS:
            self.fail(place, f"at most {MAX_ROWS} entries", str(len(found)))
        return found

    def object(self, row: Row, key: str, place: str) -> Row:
        """An object inside a row; empty where there is none."""
        found = row.get(key, {})
        if not isinstance(found, dict):
            self.fail(place, f"'{key}' as an object", shown(found))
        return found

    def row(self, kind: str, index: int, place: str) -> Row:
        """One row by its index, which stands at ``place``."""
        rows = self.rows(kind)
        if not 0 <= index < len(rows):
            self.fail(place, f"the index of one of {len(rows)} {kind}", str(index))
        return rows[index]

    def integer(self, row: Row, key: str, place: str, default: int | None = None) -> int:
        """A whole number that is not negative; without a default it is required."""
        found = row.get(key, default)
        if type(found) is float and found.is_integer():
            found = int(found)
        if type(found) is not int or not 0 <= found < 1 << 40:
            self.fail(place, f"'{key}' as a whole number, not negative", shown(found))
        return found

    def indices(self, row: Row, key: str, place: str, below: int) -> list[int]:
        """A list of indices below a limit; empty where there is none."""
        found = row.get(key, [])
        if not isinstance(found, list) or not all(type(entry) is int and 0 <= entry < below for entry in found):
            self.fail(place, f"'{key}' as a list of indices below {below}", shown(found))
        return found

    def numbers(self, row: Row, key: str, place: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """As many finite numbers as the default has."""
        found = row.get(key)
        if found is None:
            return default
        if not isinstance(found, list) or len(found) != len(default) or not all(_finite(entry) for entry in found):
            self.fail(place, f"'{key}' as {len(default)} finite numbers", shown(found))
        return tuple(float(entry) for entry in found)

    def text(self, row: Row, key: str, place: str, default: str = "") -> str:
        """A text."""
        found = row.get(key, default)
        if not isinstance(found, str):
            self.fail(place, f"'{key}' as a text", shown(found))
        return found

    def buffer(self, index: int, place: str) -> memoryview:
        """Bytes of a buffer, as many as it declares."""
        if index not in self._buffers:
            row, where = self.row("buffers", index, place), f"buffers[{index}]"
            length = self.integer(row, "byteLength", where)
            content = self._content(row, index, where)
            if len(content) < length:
                self.fail(where, f"{length} bytes", f"{len(content)} bytes", "the file is cut; export it again")
            self._loaded += len(content)
            if self._loaded > MAX_FILE_BYTES:
                self.fail(where, f"at most {MAX_FILE_BYTES} bytes in all buffers", "more")
            self._buffers[index] = memoryview(content)[:length]
        return self._buffers[index]

    def _content(self, row: Row, index: int, place: str) -> bytes:
        uri = row.get("uri")
        if uri is None:
            if index == 0 and self._binary is not None:
                return self._binary
            self.fail(place, "a uri, or the binary chunk of a .glb file", "neither")
        if not isinstance(uri, str):
            self.fail(place, "'uri' as a text", shown(uri))
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                return base64.b64decode(body, validate=True) if head.endswith(";base64") else unquote(body).encode()
            except (binascii.Error, ValueError) as err:
                raise MotionFileError(self.path, place, "base64 data in the uri", str(err)) from err
        return self._sibling(uri, place)

    def _sibling(self, uri: str, place: str) -> bytes:
        """Bytes of a file in the folder of this one, or below it."""
        try:
            parts = urlsplit(uri)
            folder = self.path.parent.resolve()
            path = (folder / unquote(parts.path)).resolve()
            inside = path.is_relative_to(folder) and not parts.scheme and not parts.netloc
        except (OSError, ValueError, RuntimeError):
            inside, path = False, self.path
        if not inside:
            self.fail(place, "a uri inside the file's own folder", shown(uri), "put the buffer beside the file")
        try:
            return file_content(path)
        except MotionFileError as err:
            found = f"{shown(uri)}: {err.found}"
            raise MotionFileError(self.path, place, err.expected, found, "put the buffer beside the file") from err


def open_document(path: Path) -> Document:
    """Read a ``.glb`` or ``.gltf`` file; which of the two it is, is seen from its first bytes.

    Raises
    ------
    MotionFileError
        It is neither, is cut, or is of another version.
    """
    content = file_content(path)
    binary: bytes | None = None
    text, place = content, "JSON"
    if content[:4] == b"glTF":
        text, binary = _chunks(path, content)
        place = "JSON chunk"
    if len(text) > MAX_JSON_BYTES:
        raise MotionFileError(path, place, f"at most {MAX_JSON_BYTES} bytes", f"{len(text)} bytes")
    try:
        table = json.loads(text.decode("utf-8-sig"), parse_constant=_no_constant)
    except (ValueError, RecursionError) as err:  # ValueError: JSON, UTF-8, or a number of thousands of digits
        found = str(err)[:200] if text else "nothing"
        raise MotionFileError(path, place, "a glTF file: valid JSON", found, "export it again") from err
    if not isinstance(table, dict) or not isinstance(table.get("asset"), dict):
        raise MotionFileError(path, place, "an object with 'asset'", shown(table), "export it as glTF 2.0")
    version = str(table["asset"].get("version", "none"))
    if not version.startswith("2."):
        raise MotionFileError(path, "asset", "version 2", version[:20], "export it as glTF 2.0")
    return Document(path, table, binary)


def _chunks(path: Path, content: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a GLB file."""
    if len(content) < _HEADER.size:
        raise MotionFileError(path, "header", f"{_HEADER.size} bytes", f"{len(content)} bytes", "export it again")
    _, version, length = _HEADER.unpack_from(content)
    if version != 2:
        raise MotionFileError(path, "header", "version 2", str(version), "export it as glTF 2.0")
    if length > len(content):
        raise MotionFileError(
            path, "header", f"{length} bytes", f"{len(content)} bytes", "the file is cut; copy or export it again"
        )
    chunks: dict[int, bytes] = {}
    at = _HEADER.size
    while at + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if size > length - at:
            raise MotionFileError(path, f"chunk at byte {at}", f"at most {length - at} bytes", f"{size} bytes")
        if at == _HEADER.size + _CHUNK.size and kind != _JSON:
            raise MotionFileError(path, "first chunk", "JSON", f"type 0x{kind:08x}", "export it again")
        if kind in (_JSON, _BIN):
            chunks.setdefault(kind, content[at : at + size])
        at += size + -size % 4
    if _JSON not in chunks:
        raise MotionFileError(path, "first chunk", "JSON", "nothing", "export it again")
    return chunks[_JSON], chunks.get(_BIN)


def shown(value: object) -> str:
    """The start of a value as text, for errors."""
    if isinstance(value, (list, dict)) and len(value) > 8:
        return f"a {'list' if isinstance(value, list) else 'table'} of {len(value)} entries"
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:60] + "…"


def _finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return math.isfinite(value) and abs(value) <= _LARGEST if isinstance(value, float) else abs(value) <= _LARGEST


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"the number {name}")
