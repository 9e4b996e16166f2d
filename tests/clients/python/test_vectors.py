"""The client against the test vectors of the wire, ``tests/golden/wire_vectors.v1.json``."""

import json
import math

import numpy as np
import pytest
from adverb_client import (
    Clock,
    DecodeError,
    JitterBuffer,
    Lateness,
    Layout,
    decode_message,
    encode_adverbs,
    encode_bulk_adverbs,
    errors,
)
from adverb_client.messages import (
    BudgetReport,
    ChannelOpened,
    CommandRejected,
    Hello,
    KeytimesPassed,
    MotionEnded,
    Pong,
    ServerDraining,
    VersionChanged,
    parse_message,
)
from adverb_client.records import decode_q32, decode_q48

from tests.clients.python.conftest import until
from tests.golden import make_wire_vectors

VECTORS = json.loads(make_wire_vectors.PATH.read_text(encoding="utf-8"))
SECONDS = VECTORS["tolerances"]["seconds"]
TOLERANCE_RAD = {name: VECTORS[name]["tolerance_rad"] for name in ("q48", "q32")}
Q48_RAD = TOLERANCE_RAD["q48"]


def named(part: str):
    rows = VECTORS[part]
    return pytest.mark.parametrize("vector", rows, ids=[str(row.get("name", k)) for k, row in enumerate(rows)])


def layouts_of(vector) -> dict[int, Layout]:
    return {int(number): Layout.from_opened(**layout) for number, layout in vector["layouts"].items()}


def angle(found, expected) -> float:
    a, b = np.float64(found), np.float64(expected)
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return float((4.0 * np.arcsin(chord / 2.0)).max())


def test_the_file_is_what_its_generator_makes():
    assert make_wire_vectors.PATH.read_text(encoding="utf-8") == make_wire_vectors.vectors()


@named("pose_messages")
def test_pose_messages_are_decoded(vector):
    found = decode_message(bytes.fromhex(vector["hex"]), layouts_of(vector))
    header = vector["header"]
    assert (found.sequence, found.dropped) == (header["sequence"], header["dropped"])
    assert found.time_ns == int(header["time_ns"])
    records = list(found.records())
    assert len(records) == header["records"] == len(vector["records"])
    for record, expected in zip(records, vector["records"], strict=True):
        assert (record.channel, record.flags, record.version) == tuple(
            expected[name] for name in ("channel", "flags", "version")
        )
        numbers = [record.phase, record.time_s, record.duration_s]
        assert numbers == [expected[name] for name in ("phase", "time", "duration")]
        assert (None if math.isnan(record.error) else record.error) == expected["error"]
        if "weights" in expected:
            assert record.weights.tolist() == expected["weights"]
            continue
        assert record.root.tolist() == expected["root"]
        if expected["encoding"] == "f32":
            assert record.rotations.tolist() == expected["rotations"]
        else:
            assert angle(record.rotations, expected["rotations"]) < TOLERANCE_RAD[expected["encoding"]]


@named("malformed_pose_messages")
def test_malformed_pose_messages_are_rejected(vector):
    with pytest.raises(DecodeError):
        decode_message(bytes.fromhex(vector["hex"]), layouts_of(vector))


@named("layouts")
def test_layouts_are_checked(vector):
    arguments = [vector[name] for name in ("encoding", "joints", "record_bytes")]
    if vector["rejection"] is None:
        assert Layout.from_opened(*arguments).record_bytes == vector["record_bytes"]
        return
    with pytest.raises(DecodeError):
        Layout.from_opened(*arguments)


def test_q48_words_are_decoded():
    rows = VECTORS["q48"]["decode"]
    found = decode_q48(np.array([row["words"] for row in rows], np.uint16))
    unit = [np.array(row["rotation"]) / np.linalg.norm(row["rotation"]) for row in rows]
    assert angle(found, unit) < 1e-6
    rows = VECTORS["q48"]["encode"]
    found = decode_q48(np.array([row["words"] for row in rows], np.uint16))
    assert angle(found, [row["rotation"] for row in rows]) < Q48_RAD


def test_q32_words_are_decoded():
    rows = VECTORS["q32"]["decode"]
    found = decode_q32(np.array([row["word"] for row in rows], np.uint32))
    unit = [np.array(row["rotation"]) / np.linalg.norm(row["rotation"]) for row in rows]
    assert angle(found, unit) < 1e-6
    rows = VECTORS["q32"]["encode"]
    found = decode_q32(np.array([row["word"] for row in rows], np.uint32))
    assert angle(found, [row["rotation"] for row in rows]) < TOLERANCE_RAD["q32"]


@named("bulk_adverb_messages")
def test_adverbs_of_many_channels_are_encoded(vector):
    (content,) = encode_bulk_adverbs(vector["channels"], vector["adverbs"])
    assert content.hex() == vector["hex"]


@named("adverb_messages")
def test_adverbs_are_encoded(vector):
    assert encode_adverbs(vector["channel"], vector["adverbs"]).hex() == vector["hex"]


KINDS = {
    "hello": Hello,
    "opened": ChannelOpened,
    "version": VersionChanged,
    "events": KeytimesPassed,
    "stats": BudgetReport,
    "end": MotionEnded,
    "pong": Pong,
    "error": CommandRejected,
    "drain": ServerDraining,
}


@named("server_messages")
def test_server_messages_are_parsed(vector):
    found, fields = parse_message(vector["text"]), vector["fields"]
    if fields is None:
        assert found is None
        return
    assert type(found) is KINDS[fields["op"]]
    for name, value in fields.items():
        if name != "op":
            assert plain(found, name) == value, name


GOALS = {"x": 0.1, "mood": 0.5}  # not parsed by this client
CONVERTED = {
    "items": lambda found: [{"channel": row.channel, "name": row.name, "phase": row.phase} for row in found.items],
    "server_time_ns": lambda found: str(found.server_time_ns),
    "code": lambda found: found.error.code,
    "detail": lambda found: found.detail if isinstance(found, ServerDraining) else found.error.detail,
    "record_bytes": lambda found: getattr(found, "layout", found).record_bytes,
    "skeleton": lambda found: {
        "names": list(found.skeleton.names),
        "parents": found.skeleton.parents.tolist(),
        "offsets": found.skeleton.offsets.tolist(),
    },
    "keytimes": lambda found: [{"name": name, "phase": phase} for name, phase in found.keytimes.items()],
    "adverbs": lambda found: [
        {name: getattr(row, name) for name in ("name", "unit", "min", "max", "style")} | {"goal": GOALS[row.name]}
        for row in found.adverbs
    ],
}


def plain(found, name):
    """A field of a parsed message as JSON has it."""
    value = CONVERTED[name](found) if name in CONVERTED else getattr(found, name)
    return list(value) if isinstance(value, tuple) else value


def test_error_codes_have_their_classes():
    for vector in VECTORS["server_messages"]:
        fields = vector["fields"]
        if fields is not None and fields["op"] == "error":
            assert type(parse_message(vector["text"]).error) is errors.error_class(fields["code"])


@named("malformed_server_messages")
def test_malformed_server_messages_are_rejected(vector):
    with pytest.raises(DecodeError):
        parse_message(vector["text"])


def client_message(op: str, k: int = 0):
    return [row["fields"] for row in VECTORS["client_messages"] if row["fields"]["op"] == op][k]


def arguments_of(fields):
    return {name: value for name, value in fields.items() if name not in ("op", "channel", "verb")}


@pytest.mark.anyio
async def test_client_messages_are_those_of_the_vectors(stream, fake):
    full, least = client_message("open", 0), client_message("open", 1)
    channel = await stream.open("reach", number=full["channel"], **arguments_of(full))
    await stream.open("reach", number=least["channel"])
    assert fake.received("open") == [full, least]
    for k in range(2):
        channel.set(**arguments_of(client_message("set", k)))
        await stream.ping()
        assert fake.received("set")[k] == client_message("set", k)
    for k in range(2):
        fields = client_message("switch", k)
        await stream.switch(channel, fields["verb"], **arguments_of(fields))
        assert fake.received("switch")[k] == fields
    assert [set(row) for row in fake.received("ping")] == [{"op", "t"}] * len(fake.received("ping"))
    for k in range(4):
        fields = client_message("view", k)
        place = [fields[name] for name in "xyz"] if "x" in fields else None
        stream.view(place, budget_kbps=fields.get("budget_kbps"))
        await stream.ping()
        assert fake.received("view")[k] == fields
    await fake.drop()
    await until(lambda: fake.received("resume"))
    assert set(fake.received("resume")[0]) == set(client_message("resume"))
    await until(lambda: stream.live)
    await stream.close_channel(channel)
    await until(lambda: fake.received("close"))
    assert fake.received("close") == [client_message("close")]


@named("clocks")
def test_the_clock_estimates_the_offset(vector):
    clock = Clock()
    for ping in vector["pings"]:
        clock.add(ping["sent_s"], ping["arrived_s"], int(ping["server_time_ns"]))
    assert clock.offset_s == pytest.approx(vector["offset_s"], abs=SECONDS, rel=0)
    assert clock.round_trip_s == pytest.approx(vector["round_trip_s"], abs=SECONDS)


@named("jitter")
def test_the_jitter_buffer_has_the_delay(vector):
    lateness = Lateness()
    for arrived_s, due_s in vector["arrived_due_s"]:
        lateness.add(arrived_s, due_s)
    found = lateness.measured()
    assert found == pytest.approx((vector["min_transit_s"], vector["lateness_s"]), abs=SECONDS, rel=0)
    assert JitterBuffer(lateness, vector["interval_s"]).delay_s == pytest.approx(vector["delay_s"], abs=SECONDS)
