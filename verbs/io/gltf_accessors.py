"""Arrays of a glTF file: accessors of every component type, normalised or sparse; checked before memory is taken.

Source: Khronos, "glTF 2.0 Specification", sections 3.6.2 and 3.11.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.io.gltf_document import Document, Row

__all__ = ["Accessors"]

_TYPES: dict[int, np.dtype[Any]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_COMPRESSED = ("EXT_meshopt_compression", "MESHOPT_compression", "KHR_draco_mesh_compression")


class Accessors:
    """Reads the accessors of a document, each once."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self._read: dict[int, F64] = {}

    def array(self, index: int, place: str, kind: str, most: int) -> F64:
        """Elements (n, width) of an accessor; ``kind`` is the type it must have, ``most`` the largest n.

        Raises
        ------
        MotionFileError
            The accessor is invalid, leads out of its buffer, or holds a number that is not finite.
        """
        if index not in self._read:
            self._read[index] = self._elements(index, place, kind, most)
        found = self._read[index]
        where = f"accessors[{index}]"
        if found.shape[1] != _WIDTHS[kind] or len(found) > most:
            self.document.fail(where, f"at most {most} of {kind}", f"{len(found)} of width {found.shape[1]}")
        return found

    def _elements(self, index: int, place: str, kind: str, most: int) -> F64:
        document, where = self.document, f"accessors[{index}]"
        row = document.row("accessors", index, place)
        if row.get("type") != kind:
            document.fail(where, f"type {kind}", str(row.get("type"))[:20])
        count, width = document.integer(row, "count", where), _WIDTHS[kind]
        if not 1 <= count <= most:
            document.fail(where, f"1 to {most} elements", str(count))
        dtype = self._dtype(row, where)
        if "bufferView" in row:
            raw = self._view(row, where, dtype, count, width)
        elif "sparse" in row:
            raw = np.zeros((count, width), dtype)
        else:
            document.fail(where, "a bufferView, or sparse values", "neither")
        if "sparse" in row:
            raw = self._sparse(document.object(row, "sparse", where), f"{where}.sparse", raw)
        values = _decoded(raw, normalized=row.get("normalized") is True)
        if not np.isfinite(values).all():
            bad = int(np.argmax(~np.isfinite(values).all(axis=1)))
            document.fail(where, "finite numbers", f"{values[bad].tolist()} in element {bad}", "export it again")
        return values

    def _dtype(self, row: Row, place: str) -> np.dtype[Any]:
        number = self.document.integer(row, "componentType", place)
        if number not in _TYPES:
            self.document.fail(place, f"componentType {', '.join(map(str, _TYPES))}", str(number))
        return _TYPES[number]

    def _view(self, row: Row, place: str, dtype: np.dtype[Any], count: int, width: int) -> np.ndarray[Any, Any]:
        """Elements (count, width) that a row with ``bufferView`` and ``byteOffset`` points to."""
        document = self.document
        number = document.integer(row, "bufferView", place)
        view, where = document.row("bufferViews", number, place), f"bufferViews[{number}]"
        packed = [name for name in _COMPRESSED if name in document.object(view, "extensions", where)]
        if packed:
            document.fail(where, "plain data", f"compression by {packed[0]}", "export it without compression")
        data = document.buffer(document.integer(view, "buffer", where), where)
        begin, length = document.integer(view, "byteOffset", where, 0), document.integer(view, "byteLength", where)
        if begin + length > len(data):
            document.fail(where, f"a range in {len(data)} bytes", f"bytes {begin} to {begin + length}")
        size = dtype.itemsize * width
        stride = document.integer(view, "byteStride", where, size) or size
        offset = document.integer(row, "byteOffset", place, 0)
        if stride < size or offset + (count - 1) * stride + size > length:
            found = f"{count} elements of {size} bytes every {stride} from byte {offset}"
            document.fail(place, f"elements inside the {length} bytes of {where}", found)
        return np.ndarray((count, width), dtype, data, begin + offset, (stride, dtype.itemsize))

    def _sparse(self, sparse: Row, place: str, dense: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Dense elements (n, width) with some replaced."""
        document = self.document
        count = document.integer(sparse, "count", place)
        if not 1 <= count <= len(dense):
            document.fail(place, f"1 to {len(dense)} elements", str(count))
        rows, values = document.object(sparse, "indices", place), document.object(sparse, "values", place)
        dtype = self._dtype(rows, f"{place}.indices")
        if dtype.kind != "u":
            document.fail(f"{place}.indices", "unsigned integers", str(dtype))
        indices = self._view(rows, f"{place}.indices", dtype, count, 1)[:, 0].astype(np.int64)
        if indices.max() >= len(dense) or (np.diff(indices) <= 0).any():
            document.fail(f"{place}.indices", f"rising indices below {len(dense)}", str(indices[:5].tolist()))
        filled = dense.copy()
        filled[indices] = self._view(values, f"{place}.values", dense.dtype, count, dense.shape[1])
        return filled


def _decoded(raw: np.ndarray[Any, Any], *, normalized: bool) -> F64:
    """Numbers of stored elements; normalised integers cover -1 to 1, or 0 to 1."""
    with np.errstate(invalid="ignore"):  # signalling NaN
        values = raw.astype(np.float64)
    if normalized and raw.dtype.kind in "iu":
        values = np.maximum(values / np.iinfo(raw.dtype).max, -1.0)
    return values
