"""The stream against a simulated server on a real socket."""

import asyncio
import json

import numpy as np
import pytest
from adverb_client import (
    CommandRejected,
    ConnectionRestored,
    KeytimePassed,
    MotionEnded,
    Stream,
    StreamClosed,
    StreamEnded,
    TimedOut,
    errors,
)
from adverb_client.connection import stream_url

from tests.clients.python.conftest import next_event, until

pytestmark = pytest.mark.anyio

AT = {"x": 0.5, "y": 1.0, "z": 0.5}


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://a:1", "ws://a:1/v1/stream"),
        ("https://a/", "wss://a/v1/stream"),
        ("https://a/adverb", "wss://a/adverb/v1/stream"),
        ("https://a/adverb/v1/stream", "wss://a/adverb/v1/stream"),
        ("ws://a/b?c=d", "ws://a/b?c=d"),
    ],
)
async def test_every_address_of_a_server_is_accepted(url, expected):
    assert stream_url(url) == expected


@pytest.mark.parametrize("url", ["ftp://a", "a:1", "http://"])
async def test_other_addresses_are_rejected(url):
    with pytest.raises(ValueError, match="not the address of a server"):
        stream_url(url)


@pytest.mark.parametrize("encoding", ["f32", "q48", "weights", "q32"])
async def test_poses_arrive_in_every_encoding(stream, encoding):
    channel = await stream.open("reach", adverbs=AT, encoding=encoding, phase=0.25, play=False)
    assert channel.info.encoding == encoding
    assert channel.info.keytimes == {"half": 0.5}
    assert channel.info.follow == (0.4, 0.6)
    await until(lambda: channel.pose() is not None)
    sample = stream.pose(channel.number)
    assert sample.phase == pytest.approx(0.25)
    if encoding == "weights":
        np.testing.assert_allclose(sample.weights, [0.2] * 5, atol=1e-6)
        return
    half = np.pi * 0.25
    np.testing.assert_allclose(sample.rotations[0], [0.0, np.sin(half), 0.0, np.cos(half)], atol=2e-4)
    np.testing.assert_allclose(sample.root, [0.5, 1.0, 0.25], atol=1e-6)
    places = channel.positions(sample)
    np.testing.assert_allclose(places[2], [0.5, 1.5, 0.25 - 0.3], atol=1e-3)  # a quarter turn about +Y: +X to -Z


async def test_many_channels_of_different_layouts_share_messages(stream):
    kinds = ["f32", "q48", "weights", "q32"] * 3
    channels = [await stream.open("reach", encoding=kind, adverbs={**AT, "x": k / 20}) for k, kind in enumerate(kinds)]
    await until(lambda: all(channel.pose() is not None for channel in channels))
    assert stream.stats.decode_errors == 0
    for k, channel in enumerate(channels):
        if kinds[k] != "weights":
            assert channel.pose().root[0] == pytest.approx(k / 20, abs=1e-6)
    assert stream.stats.records > stream.stats.messages


async def test_a_first_connection_is_no_reconnection(stream):
    await stream.open("reach", adverbs=AT)
    assert stream.stats.reconnects == 0
    assert not any(isinstance(event, ConnectionRestored) for event in stream.take_events())


async def test_aim_and_set_are_sent(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    channel.aim([0.25, 1.0, 0.5])
    await until(lambda: (0x10, channel.number, [0.25, 1.0, 0.5]) in fake.messages)
    channel.set(adverbs={"x": -0.5}, speed=0.5)
    await until(lambda: fake.received("set"))
    assert fake.received("set")[-1] == {"op": "set", "channel": channel.number, "adverbs": {"x": -0.5}, "speed": 0.5}
    await until(lambda: channel.pose() is not None and abs(channel.pose().root[0] + 0.5) < 1e-6)


async def test_an_unsent_message_is_replaced_by_a_newer_one(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    for k in range(50):
        channel.aim([k / 100, 1.0, 0.5])
        channel.set(speed=k / 10)
        channel.set(adverbs={"y": float(k)})
    await until(lambda: fake.received("set"))
    aims = [row for row in fake.messages if isinstance(row, tuple)]
    assert len(aims) == 1
    assert aims[0][2][0] == pytest.approx(0.49)
    assert fake.received("set") == [{"op": "set", "channel": channel.number, "speed": 4.9, "adverbs": {"y": 49.0}}]


async def test_invalid_arguments_raise_before_anything_is_sent(stream):
    channel = await stream.open("reach", adverbs=AT)
    with pytest.raises(ValueError, match="2 adverbs given; 'reach' has 3: x, y, z"):
        channel.aim([0.0, 1.0])
    with pytest.raises(ValueError, match="finite"):
        channel.set(adverbs={"x": float("nan")})
    with pytest.raises(ValueError, match="open already"):
        await stream.open("reach", number=channel.number)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"fps": 0}, "fps 0; expected an integer from 1 to 120"),
        ({"fps": 121}, "fps 121"),
        ({"fps": 29.97}, "fps 29.97"),
        ({"fps": True}, "fps True"),
        ({"fps": float("nan")}, "fps nan"),
        ({"speed": 10.5}, "speed 10.5; expected -10 to 10"),
        ({"speed": float("inf")}, "speed inf"),
        ({"half_life": -0.1}, "half_life -0.1; expected 0 to 10"),
        ({"half_life": "slow"}, "half_life 'slow'"),
        ({"phase": 1.5}, "phase 1.5; expected 0 to 1"),
        ({"phase": float("nan")}, "phase nan"),
    ],
)
async def test_open_and_set_reject_numbers_out_of_range(stream, fake, options, match):
    with pytest.raises(ValueError, match=match):
        await stream.open("reach", **options)
    assert not stream.channels
    channel = await stream.open("reach")
    with pytest.raises(ValueError, match=match):
        channel.set(**options)
    await stream.ping()
    assert len(fake.received("open")) == 1
    assert not fake.received("set")


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"encoding": "f64"}, "encoding 'f64'; expected one of f32, q48, q32, weights"),
        ({"space": "world"}, "space 'world'; expected one of local, global"),
        ({"frame": "maya"}, "frame 'maya'; expected one of gltf, unity, unreal, zup"),
        ({"adverbs": {"x": float("nan")}}, "finite"),
        ({"colour": "red"}, "unknown option 'colour'"),
        ({"number": 65_536}, "not 0 to 65,535"),
    ],
)
async def test_open_rejects_unknown_options(stream, fake, options, match):
    with pytest.raises(ValueError, match=match):
        await stream.open("reach", **options)
    assert not stream.channels
    await stream.ping()
    assert not fake.received("open")


@pytest.mark.parametrize(
    ("options", "match"), [({"phase": -0.1}, "phase -0.1"), ({"transition_s": 6}, "transition_s 6; expected 0 to 5")]
)
async def test_switch_rejects_numbers_out_of_range(stream, fake, options, match):
    channel = await stream.open("reach")
    with pytest.raises(ValueError, match=match):
        await stream.switch(channel, "board", **options)
    await stream.ping()
    assert not fake.received("switch")
    assert channel.switch is None


async def test_an_error_message_raises_the_error_of_its_code(stream):
    with pytest.raises(errors.UnknownVerb, match="it is unknown_verb") as caught:
        await stream.open("nothing")
    assert caught.value.code == "unknown_verb"
    assert not stream.channels
    channel = await stream.open("reach", adverbs=AT)
    with pytest.raises(errors.UnknownVerb):
        await stream.switch(channel, "nothing")
    assert channel.verb == "reach"
    await until(lambda: channel.pose() is not None)


async def test_open_is_repeated_while_the_server_is_not_ready(stream, fake):
    fake.not_ready = 1
    channel = await stream.open("reach", adverbs=AT)
    assert channel.info.verb == "reach"


async def test_open_without_answer_times_out_and_a_late_answer_is_closed(stream, fake):
    fake.mute.add("open")
    with pytest.raises(TimedOut, match="open of channel 0"):
        await stream.open("reach", timeout_s=0.05)
    socket = next(iter(fake.sockets))
    channel = await _late_open(fake, socket, 0)
    await until(lambda: fake.received("close"))
    assert fake.received("close") == [{"op": "close", "channel": channel}]


async def _late_open(fake, socket, number: int) -> int:
    await fake.on_open(socket, [next(iter(fake.sessions.values()))], {"channel": number, "verb": "reach"})
    return number


async def test_switching_keeps_the_channel_and_changes_its_adverbs(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    opened = await stream.switch(channel, "board", adverbs={"u": 0.25, "v": 0.0}, transition_s=0.1)
    assert opened.verb == channel.verb == "board"
    assert [adverb.name for adverb in channel.info.adverbs] == ["u", "v"]
    channel.aim([0.5, 0.0])
    await until(lambda: (0x10, channel.number, [0.5, 0.0]) in fake.messages)
    assert fake.received("switch")[0]["transition_s"] == 0.1


async def test_late_records_of_a_closed_channel_are_ignored(stream, fake):
    first = await stream.open("reach", adverbs=AT)
    second = await stream.open("reach", adverbs=AT, encoding="q48")
    await until(lambda: first.pose() is not None)
    await stream.close_channel(first)
    await until(lambda: fake.received("close"))
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 5)
    assert stream.stats.decode_errors == 0
    assert list(stream.channels) == [second.number]
    assert (await stream.open("reach")).number == 2  # numbers are not reused at once


async def test_a_reused_channel_number_shows_no_pose_of_the_old_channel(stream, fake):
    first = await stream.open("reach", adverbs=AT)
    fake.mute = {"close", "open"}  # its records continue, like those in flight
    await stream.close_channel(first)
    requested = asyncio.create_task(stream.open("reach", number=first.number, encoding="weights", timeout_s=1.0))
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 5)
    again = stream.channels[first.number]
    assert again is not first
    assert again.pose() is None
    with pytest.raises(TimedOut):
        await requested


async def test_keytimes_and_ends_are_events(stream):
    channel = await stream.open("once", adverbs={"x": 0.0})
    passed, ended = await next_event(stream, KeytimePassed), await next_event(stream, MotionEnded)
    assert (passed.channel, passed.name, passed.phase) == (channel.number, "half", 0.5)
    assert ended.channel == channel.number
    await until(lambda: channel.pose() is not None and channel.pose().ended)
    assert channel.pose().phase == pytest.approx(1.0)


async def test_an_error_without_a_pending_request_is_an_event(stream):
    channel = await stream.open("reach", adverbs=AT)
    stream._outbox.put(None, {"op": "set", "channel": 999, "speed": 1.0})
    rejected = await next_event(stream, CommandRejected)
    assert rejected.channel == 999
    assert isinstance(rejected.error, errors.UnknownChannel)
    await until(lambda: channel.pose() is not None)


async def test_events_can_go_to_a_callback(fake):
    seen = []
    async with Stream(fake.url, on_event=seen.append) as stream:
        await stream.open("once", adverbs={"x": 0.0})
        await until(lambda: any(isinstance(event, MotionEnded) for event in seen))
        assert not stream.take_events()
    assert isinstance(seen[-1], StreamEnded)


async def test_unread_events_are_bounded_and_counted(fake):
    async with Stream(fake.url, max_events=3) as stream:
        for _ in range(5):
            await stream.open("reach")
        assert stream.stats.events_dropped == 2
        assert [event.channel for event in stream.take_events()] == [2, 3, 4]


async def test_the_servers_clock_is_estimated(fake):
    fake.skew_ns = 3_600 * 10**9
    async with Stream(fake.url) as stream:
        trip_s = await stream.ping()
        assert 0.0 < trip_s < 1.0
        offset_s = fake.now_ns() * 1e-9 - stream.now()
        assert stream.clock.offset_s == pytest.approx(offset_s, abs=0.05)
        channel = await stream.open("reach")
        await until(lambda: channel.pose() is not None)
        assert abs(stream.age_s) < 0.5
        assert stream.lateness_s >= 0.0


async def test_settings_during_a_switch_apply_to_the_new_verb(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    switching = asyncio.create_task(stream.switch(channel, "board"))
    await asyncio.sleep(0)  # sent, without an answer
    assert channel.switch is not None
    channel.set(adverbs={"u": 0.25})
    channel.aim([0.5, 0.5])
    await switching
    assert "adverbs" not in fake.received("switch")[0]
    assert channel.desired["adverbs"] == {"u": 0.5, "v": 0.5}
    await until(lambda: (0x10, channel.number, [0.5, 0.5]) in fake.messages)


async def test_malformed_messages_are_counted_and_ignored(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await until(lambda: channel.pose() is not None)
    socket = next(iter(fake.sockets))
    for bad in (b"", b"\x01\x01\xff\xff", b"\x07" * 40, "no json", "[1]", '{"op": "events"}', '{"op": "opened"}'):
        await socket.send(bad)
    for bad in ('{"op": "pong", "t": "x", "server_time_ns": 1}', '{"op": "pong", "t": Infinity, "server_time_ns": 1}'):
        await socket.send(bad)
    await socket.send(json.dumps({"op": "tomorrow", "what": "is new"}))
    await until(lambda: stream.stats.decode_errors == 9)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 2)
    assert stream.stats.last_error


async def test_gaps_in_the_sequence_are_counted(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await until(lambda: channel.pose() is not None)
    session = fake.sessions["s1"]
    session.sequence += 7
    session.dropped += 7
    await until(lambda: stream.stats.gaps == 1)
    assert (stream.stats.missing, stream.stats.dropped) == (7, 7)
    session.sequence -= 5
    await until(lambda: stream.stats.stale > 2)


async def test_close_ends_iteration_and_pending_requests(fake):
    stream = Stream(fake.url)
    await stream.connect()
    fake.mute.add("open")
    opening = asyncio.create_task(stream.open("reach"))
    await until(lambda: fake.received("open"))
    await stream.close()
    await stream.close()
    with pytest.raises(StreamClosed, match="closed by this client"):
        await opening
    assert [type(event) async for event in stream] == [StreamEnded]
