"""Binary glTF files whose data is in several buffers."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path


def split(content: bytes, folder: Path) -> bytes:
    """A .glb file whose views are shared out over its binary chunk, a file beside it and a data uri."""
    size = struct.unpack_from("<I", content, 12)[0]
    table, binary = json.loads(content[20 : 20 + size]), content[28 + size :]
    parts = [bytearray() for _ in range(3)]
    for number, view in enumerate(table["bufferViews"]):
        part = parts[number % 3]
        part += bytes(-len(part) % 4)
        start = view.get("byteOffset", 0)
        view |= {"buffer": number % 3, "byteOffset": len(part)}
        part += binary[start : start + view["byteLength"]]
    (folder / "more.bin").write_bytes(parts[1])
    uri = "data:application/octet-stream;base64," + base64.b64encode(parts[2]).decode()
    uris: list[dict[str, str]] = [{}, {"uri": "more.bin"}, {"uri": uri}]
    table["buffers"] = [row | {"byteLength": len(part)} for row, part in zip(uris, parts, strict=True)]
    return glb(table, bytes(parts[0]))


def glb(table: dict[str, object], binary: bytes) -> bytes:
    """Bytes of a .glb file."""
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
