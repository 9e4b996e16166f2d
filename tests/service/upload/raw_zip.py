"""Zip archives with any names, modes and methods, written without :mod:`zipfile`, which refuses or changes some."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from typing import NamedTuple

_SIZE = 0xFFFF


class Row(NamedTuple):
    """One file: its name, Unix mode, content, and method; 8 is deflate, others are stored as they are."""

    name: bytes
    content: bytes = b""
    mode: int = 0o100644
    method: int = 0


def raw_zip(rows: Iterable[Row]) -> bytes:
    """An archive with valid lengths and checksums."""
    body: list[bytes] = []
    central: list[bytes] = []
    count = start = 0
    for row in rows:
        packer = zlib.compressobj(wbits=-15)
        content = packer.compress(row.content) + packer.flush() if row.method == 8 else row.content
        sizes = zlib.crc32(row.content), len(content), len(row.content), len(row.name), 0
        head = struct.pack("<HHHHHIIIHH", 20, 0x800, row.method, 0, 0, *sizes)
        central.append(b"PK\1\2\x14\3" + head + struct.pack("<HHHII", 0, 0, 0, row.mode << 16, start) + row.name)
        body.append(b"PK\3\4" + head + row.name + content)
        count, start = count + 1, start + len(body[-1])
    listing = b"".join(central)
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, count & _SIZE, count & _SIZE, len(listing), start, 0)
    return b"".join(body) + listing + end
