"""Binary glTF container: arrays as accessors, and the JSON table that names them.

Source: Khronos, "glTF 2.0 Specification", sections 3.6 and 4.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from verbs.conventions import Floats

__all__ = ["ELEMENT_ARRAY", "VERTEX_ARRAY", "GlbBuilder"]

VERTEX_ARRAY, ELEMENT_ARRAY = 34962, 34963
"""Targets of buffer views that hold vertices and indices."""

_COMPONENTS = {np.dtype("<u1"): 5121, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125, np.dtype("<f4"): 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_GENERATOR = "Adverb"

Row = dict[str, Any]


class GlbBuilder:
    """Collects the rows of a glTF document and its binary data; equal calls give equal bytes.

    Parameters
    ----------
    extras : mapping, optional
        JSON values for ``asset.extras``.
    """

    def __init__(self, extras: Mapping[str, Any] | None = None) -> None:
        asset: Row = {"version": "2.0", "generator": _GENERATOR}
        self.table: Row = {"asset": asset | ({"extras": dict(extras)} if extras else {})}
        self._data = bytearray()

    @classmethod
    def of(cls, table: Row, binary: bytes | None) -> GlbBuilder:
        """A builder that continues a document whose only buffer, if any, is ``binary``."""
        builder = cls()
        builder.table = table
        builder._data = bytearray(binary or b"")
        return builder

    def add(self, kind: str, row: Row) -> int:
        """Append a row to an array of the document, such as ``nodes``; returns its index."""
        rows: list[Row] = self.table.setdefault(kind, [])
        rows.append(row)
        return len(rows) - 1

    def floats(self, values: Floats, *, target: int | None = None, bounds: bool = False) -> int:
        """Accessor of float32 values (n,) or (n, width), with their minimum and maximum where ``bounds`` is set."""
        return self.accessor(np.ascontiguousarray(values, "<f4"), target=target, bounds=bounds)

    def accessor(self, values: np.ndarray[Any, Any], *, target: int | None = None, bounds: bool = False) -> int:
        """Accessor of an array (n,) or (n, width) of uint8, uint16, uint32 or float32; returns its index."""
        rows = values.reshape(len(values), -1)
        self._data += bytes(-len(self._data) % 4)
        view: Row = {"buffer": 0, "byteOffset": len(self._data), "byteLength": values.nbytes}
        self._data += np.ascontiguousarray(values).tobytes()
        row: Row = {
            "bufferView": self.add("bufferViews", view | ({} if target is None else {"target": target})),
            "componentType": _COMPONENTS[values.dtype],
            "count": len(rows),
            "type": _KINDS[rows.shape[1]],
        }
        if bounds:
            row |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.add("accessors", row)

    def content(self) -> bytes:
        """Bytes of the ``.glb`` file."""
        table = self.table | {"buffers": [{"byteLength": len(self._data)}]} if self._data else self.table
        text = json.dumps(table, separators=(",", ":"), allow_nan=False).encode()
        chunks = _chunk(b"JSON", text, b" ") + (_chunk(b"BIN\0", bytes(self._data), b"\0") if self._data else b"")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _chunk(kind: bytes, content: bytes, padding: bytes) -> bytes:
    content += padding * (-len(content) % 4)
    return struct.pack("<I4s", len(content), kind) + content
