"""Checks of the load scripts on decoded messages: each accepts valid records and rejects one implausible number."""

import math
import random

import numpy as np
import pytest
from adverb_client import Clock, DecodeError, Layout, decode_message
from adverb_load.checks import check_message
from adverb_load.client import SAMPLE, Load, LoadClient
from adverb_load.tally import Tally

from tests.clients.python.specimen import Rec, message

S = math.sqrt(0.5)
POSE = [(0.0, 0.0, 0.0, 1.0), (S, 0.0, 0.0, S)]
LAYOUTS = {0: Layout(0, 2), 5: Layout(1, 2), 9: Layout(2, 2), 6: Layout(3, 2)}


def full(**changed) -> Rec:
    return Rec(0, 0, **({"phase": 0.5, "time": 0.5, "error": 0.25, "duration": 2.0, "rotations": POSE} | changed))


def packed(words=()) -> bytes:
    content = bytearray(message([Rec(5, 1, phase=0.5, time=0.5, duration=2.0, rotations=POSE)]))
    for k, word in words:
        content[56 + 2 * k : 58 + 2 * k] = int(word).to_bytes(2, "little")
    return bytes(content)


def packed_32(words=()) -> bytes:
    content = bytearray(message([Rec(6, 3, phase=0.5, time=0.5, duration=2.0, rotations=POSE)]))
    for k, word in words:
        content[56 + 4 * k : 60 + 4 * k] = int(word).to_bytes(4, "little")
    return bytes(content)


def weights(*numbers: float) -> Rec:
    return Rec(9, 2, phase=0.5, time=0.5, duration=2.0, weights=list(numbers))


def check(content: bytes) -> None:
    check_message(decode_message(content, LAYOUTS), LAYOUTS)


@pytest.mark.parametrize(
    "content",
    [
        message([full(), weights(1.5, -0.5)]),
        message([full(error=math.nan, phase=1.0, time=0.0)]),
        packed(),
        packed_32(),
    ],
)
def test_valid_messages_pass(content):
    check(content)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (message([full(phase=1.5)]), "phase 1.5"),
        (message([full(), full(time=-0.5)]), "time -0.5"),
        (message([full(duration=0.0)]), "duration 0.0"),
        (message([full(error=-1.0)]), "error -1.0"),
        (message([full(rotations=[POSE[0], (0.0, 0.0, 0.0, 0.5)])]), "length 0.5 to 1.0"),
        (packed([(2, 16_383 | 1 << 15)]), "out of range"),
        (packed_32([(0, 1_023)]), "out of range"),
        (packed_32([(1, 1_022 | 1_022 << 10)]), "not the largest"),
        (packed([(0, 32_767 | 1 << 15)]), "out of range"),
        (packed([(0, 32_766), (1, 32_766), (2, 32_766)]), "not the largest"),
        (message([weights(1.5, 0.5)]), "sum"),
        (message([weights(0.5, 0.25, 0.25)]), r"3 weights in records of \[2\]"),
    ],
)
def test_implausible_messages_are_rejected(content, match):
    with pytest.raises(DecodeError, match=match):
        check(content)


def test_a_client_checks_one_message_of_a_sample():
    client = LoadClient(Load("ws://a", "reach"), Tally(), Clock(), random.Random(1), None)
    client.layouts = LAYOUTS
    for k in range(1, 3 * SAMPLE + 1):
        bad = k == 2 * SAMPLE
        client.binary(message([full(phase=1.5 if bad else 0.5)], sequence=k), 0)
    assert (client.tally.messages, client.tally.decoded, client.tally.wrong, client.tally.gaps) == (3 * SAMPLE, 3, 1, 0)
    assert client.tally.problems[0].startswith("phase 1.5")


def test_binary_messages_of_adverbs_are_those_of_the_client_library():
    from adverb_client import encode_adverbs
    from adverb_load.client import adverbs_header

    row = np.float32([0.25, -1.0])
    assert adverbs_header(513) + row.tobytes() == encode_adverbs(513, row)
