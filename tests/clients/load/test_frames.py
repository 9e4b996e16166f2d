"""Frames against the examples of RFC 6455, and in chunks of any size."""

import random
import struct

import pytest
from adverb_load import frames
from adverb_load.frames import BINARY, CLOSE, PING, TEXT, FrameError, Parser

KEY = bytes.fromhex("37fa213d")


def test_masked_hello_of_the_rfc():
    assert frames.frame(TEXT, b"Hello", KEY) == bytes.fromhex("818537fa213d7f9f4d5158")


@pytest.mark.parametrize("length", [0, 1, 3, 4, 5, 125, 126, 127, 65_535, 65_536, 70_001])
def test_masking_is_its_own_inverse(length):
    payload = random.Random(length).randbytes(length)
    masked = frames.mask(payload, KEY)
    assert all(masked[k] == payload[k] ^ KEY[k % 4] for k in range(min(length, 300)))
    assert frames.mask(masked, KEY) == payload


@pytest.mark.parametrize(("length", "head"), [(125, 2), (126, 4), (65_535, 4), (65_536, 10)])
def test_lengths_are_encoded_in_their_form(length, head):
    sent = frames.frame(BINARY, bytes(length), KEY)
    assert len(sent) == head + 4 + length
    assert sent[1] & 0x80


def from_server(opcode: int, payload: bytes, *, fin: bool = True) -> bytes:
    first = bytes([(0x80 if fin else 0) | opcode])
    count = len(payload)
    if count < 126:
        return first + bytes([count]) + payload
    if count < 65_536:
        return first + b"\x7e" + struct.pack(">H", count) + payload
    return first + b"\x7f" + struct.pack(">Q", count) + payload


MESSAGES = [
    (BINARY, bytes(range(20))),
    (TEXT, b""),
    (BINARY, random.Random(1).randbytes(126)),
    (PING, b"are you there"),
    (BINARY, random.Random(2).randbytes(65_536)),
    (CLOSE, struct.pack(">H", 4008) + b"zu langsam"),
]
STREAM = b"".join(from_server(*message) for message in MESSAGES)


@pytest.mark.parametrize("step", [1, 2, 3, 7, 64, 1_000, 65_541, len(STREAM)])
def test_messages_are_parsed_from_any_chunks(step):
    parser = Parser()
    found = []
    cuts = range(0, len(STREAM), step) if step > 7 else [*range(0, 400, step), 400]
    for at, after in zip(cuts, [*list(cuts)[1:], len(STREAM)], strict=True):
        found += parser.feed(STREAM[at:after])
    assert found == MESSAGES


def test_fragments_are_joined_around_a_ping():
    parser = Parser()
    parts = from_server(TEXT, b"one ", fin=False) + from_server(PING, b"?") + from_server(0, b"two ", fin=False)
    assert parser.feed(parts) == [(PING, b"?")]
    assert parser.feed(from_server(0, b"three") + from_server(BINARY, b"4")) == [
        (TEXT, b"one two three"),
        (BINARY, b"4"),
    ]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (frames.frame(TEXT, b"x", KEY), "masked"),
        (b"\xc1\x00", "reserved bits"),
        (from_server(0, b"end of nothing"), "opcode 0"),
        (from_server(3, b""), "opcode 3"),
        (b"\x82\x7f" + struct.pack(">Q", 1 << 40), "bytes"),
        (from_server(TEXT, b"a", fin=False) + from_server(TEXT, b"b"), "opcode 1"),
    ],
)
def test_invalid_frames_are_rejected(content, match):
    with pytest.raises(FrameError, match=match):
        Parser().feed(content)


def test_a_close_frame_without_code():
    assert frames.close_code(b"") == (1005, "")
    assert frames.close_code(struct.pack(">H", 1000) + b"bye") == (1000, "bye")


NONCE = b"the sample nonce"  # RFC 6455, 1.3
ANSWER = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\nSec-WebSocket-Protocol: adverb.v1"
)


def test_handshake_of_the_rfc():
    load = frames.request("127.0.0.1", 8000, "/v1/stream", NONCE, "adverb.v1")
    assert b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" in load
    assert load.startswith(b"GET /v1/stream HTTP/1.1\r\nHost: 127.0.0.1:8000\r\n")
    assert load.endswith(b"\r\n\r\n")
    frames.accepted(ANSWER, NONCE, "adverb.v1")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"101 Switching Protocols", b"404 Not Found", "404"),
        (b"s3pP", b"s3pQ", "does not match"),
        (b"adverb.v1", b"chat", "chat"),
        (b"Upgrade: websocket", b"Sec-WebSocket-Extensions: permessage-deflate", "extension"),
    ],
)
def test_other_responses_are_rejected(old, new, match):
    with pytest.raises(FrameError, match=match):
        frames.accepted(ANSWER.replace(old, new), NONCE, "adverb.v1")
