"""WebSocket frames (RFC 6455) of a client: masked when sent, unmasked when received; no extensions."""

from __future__ import annotations

import base64
import hashlib
import struct
from collections.abc import Mapping

__all__ = [
    "BINARY", "CLOSE", "PING", "PONG", "TEXT",
    "FrameError", "Parser", "accepted", "close_code", "close_frame", "frame", "mask", "request",
]  # fmt: skip

CONTINUED, TEXT, BINARY, CLOSE, PING, PONG = 0x0, 0x1, 0x2, 0x8, 0x9, 0xA
FIN, MASKED = 0x80, 0x80
MAX_PAYLOAD = 1 << 26
"""Bytes; a longer frame is an error."""

NO_CODE = 1005
"""Code of a close frame without a code."""

_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_SHORT, _LONG, _CODE = struct.Struct(">H"), struct.Struct(">Q"), struct.Struct(">H")


class FrameError(Exception):
    """Received bytes are not valid frames of a server."""


def mask(payload: bytes, key: bytes) -> bytes:
    """A payload XORed with a key of 4 bytes; the function is its own inverse."""
    count = len(payload)
    over = (key * (count // 4 + 1))[:count]
    return (int.from_bytes(payload, "little") ^ int.from_bytes(over, "little")).to_bytes(count, "little")


def frame(opcode: int, payload: bytes, key: bytes) -> bytes:
    """A whole message in one masked frame."""
    count = len(payload)
    if count < 126:
        head = bytes((FIN | opcode, MASKED | count))
    elif count < 65_536:
        head = bytes((FIN | opcode, MASKED | 126)) + _SHORT.pack(count)
    else:
        head = bytes((FIN | opcode, MASKED | 127)) + _LONG.pack(count)
    return head + key + mask(payload, key)


def close_frame(code: int, key: bytes) -> bytes:
    """A close frame with a code and no reason."""
    return frame(CLOSE, _CODE.pack(code), key)


def close_code(payload: bytes) -> tuple[int, str]:
    """Code and reason of a close frame."""
    if len(payload) < 2:
        return NO_CODE, ""
    return _CODE.unpack_from(payload)[0], payload[2:].decode("utf-8", "replace")


class Parser:
    """Parses bytes of a server to messages."""

    def __init__(self) -> None:
        self._rest = b""
        self._parts: list[bytes] = []
        self._kind = CONTINUED

    def feed(self, content: bytes) -> list[tuple[int, bytes]]:
        """Opcode and payload of every complete message; raises :class:`FrameError`."""
        if self._rest:
            content = self._rest + content
        found: list[tuple[int, bytes]] = []
        at, end = 0, len(content)
        while end - at >= 2:
            first, count, start = content[at], content[at + 1], at + 2
            if count == 126:
                start += 2
                count = _SHORT.unpack_from(content, at + 2)[0] if end >= start else MAX_PAYLOAD
            elif count == 127:
                start += 8
                count = _LONG.unpack_from(content, at + 2)[0] if end >= start else MAX_PAYLOAD
            elif count > 127:
                raise FrameError("a server's frame is masked")
            if count > MAX_PAYLOAD:
                raise FrameError(f"a frame of {count} bytes; {MAX_PAYLOAD} are expected at most")
            if end - start < count:
                break
            at = start + count
            if 0x81 <= first <= 0x82 and not self._parts:
                found.append((first & 0x0F, content[start:at]))
            else:
                self._uncommon(first, content[start:at], found)
        self._rest = content[at:]
        return found

    def _uncommon(self, first: int, payload: bytes, found: list[tuple[int, bytes]]) -> None:
        """Handle a control frame or a fragment of a message."""
        opcode, whole = first & 0x0F, bool(first & FIN)
        if first & 0x70:
            raise FrameError(f"reserved bits in a frame's first byte, 0x{first:02x}")
        if opcode in (CLOSE, PING, PONG):
            found.append((opcode, payload))
            return
        if opcode not in (CONTINUED, TEXT, BINARY) or (opcode == CONTINUED) != bool(self._parts):
            raise FrameError(f"a frame of opcode {opcode} is not expected here")
        self._kind = opcode or self._kind
        self._parts.append(payload)
        if whole:
            found.append((self._kind, b"".join(self._parts)))
            self._parts = []


def request(
    host: str, port: int, path: str, key: bytes, subprotocol: str, headers: Mapping[str, str] | None = None
) -> bytes:
    """A client's opening request; ``key`` has 16 bytes."""
    lines = [
        f"GET {path} HTTP/1.1",
        f"Host: {host}:{port}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {base64.b64encode(key).decode()}",
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Protocol: {subprotocol}",
        *(f"{name}: {value}" for name, value in (headers or {}).items()),
    ]
    return "\r\n".join([*lines, "", ""]).encode()


def accepted(answer: bytes, key: bytes, subprotocol: str) -> None:
    """Check the header lines of a server's response; raises :class:`FrameError`."""
    status, *lines = answer.decode("latin-1").split("\r\n")
    if status.split(" ")[1:2] != ["101"]:
        raise FrameError(f"not a WebSocket: {status}")
    pairs = [line.partition(":") for line in lines if line]
    fields = {name.strip().lower(): value.strip() for name, _, value in pairs}
    expected = base64.b64encode(hashlib.sha1(base64.b64encode(key) + _GUID).digest()).decode()
    if fields.get("sec-websocket-accept") != expected:
        raise FrameError("the server's Sec-WebSocket-Accept does not match the request")
    if fields.get("sec-websocket-protocol") != subprotocol:
        raise FrameError(
            f"the server's subprotocol is {fields.get('sec-websocket-protocol')!r}, expected {subprotocol!r}"
        )
    if "sec-websocket-extensions" in fields:
        raise FrameError("the server uses an extension that was not offered")
