"""Reconnection of the stream, against a simulated server on a real socket."""

import asyncio

import pytest
from adverb_client import (
    CommandRejected,
    ConnectionLost,
    ConnectionRestored,
    ServerDraining,
    Stream,
    StreamClosed,
    StreamEnded,
    TimedOut,
)

from tests.clients.python.conftest import next_event, quick, until
from tests.clients.python.fake import running

pytestmark = pytest.mark.anyio

AT = {"x": 0.5, "y": 1.0, "z": 0.5}


async def test_a_lost_connection_is_restored_with_its_session(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await until(lambda: channel.pose() is not None)
    await fake.drop()
    await next_event(stream, ConnectionLost)
    channel.set(adverbs={"x": -0.75})  # without a connection
    found = await next_event(stream, ConnectionRestored)
    assert found.resumed
    resume = fake.received("resume")[0]
    assert resume["session"] == "s1"
    assert resume["last_seq"] > 0
    await until(lambda: abs(channel.pose().root[0] + 0.75) < 1e-6)
    assert (stream.stats.reconnects, stream.stats.resumes) == (1, 1)
    assert len(fake.received("open")) == 1
    assert stream.stats.decode_errors == 0


async def test_channels_of_an_unknown_session_are_reopened_at_their_phase(stream, fake):
    channel = await stream.open("reach", adverbs=AT, encoding="q48", play=False, phase=0.3)
    other = await stream.open("reach", adverbs=AT)
    await stream.switch(other, "board", adverbs={"u": 0.1, "v": 0.2})
    channel.aim([0.25, 1.5, 0.75])
    await until(lambda: channel.pose() is not None and abs(channel.pose().root[0] - 0.25) < 1e-6)
    fake.forget()
    await fake.drop()
    found = await next_event(stream, ConnectionRestored)
    assert not found.resumed
    await until(lambda: len(fake.received("open")) == 4)
    again, board = fake.received("open")[-2:]
    assert again["adverbs"] == {"x": 0.25, "y": 1.5, "z": 0.75}
    assert (again["encoding"], again["play"]) == ("q48", False)
    assert again["phase"] == pytest.approx(0.3, abs=1e-6)
    assert (board["verb"], board["adverbs"]) == ("board", {"u": 0.1, "v": 0.2})
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.pose().root[0] == pytest.approx(0.25)
    assert not channel.pose().held  # the new clock, an hour ahead, is used
    assert stream.stats.stale == 0
    assert stream.clock.offset_s == pytest.approx(fake.now_ns() * 1e-9 - stream.now(), abs=0.05)


async def test_partly_known_adverbs_are_set_after_a_channel_is_reopened(stream, fake):
    channel = await stream.open("reach")
    channel.set(adverbs={"x": 0.75})
    await until(lambda: fake.received("set"))
    fake.forget()
    await fake.drop()
    await until(lambda: len(fake.received("set")) == 2)
    assert "adverbs" not in fake.received("open")[-1]  # `open` takes all adverbs or none
    assert fake.received("set")[-1]["adverbs"] == {"x": 0.75}


async def test_channels_are_reopened_after_a_restarted_server_is_ready(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 2
    await fake.drop()
    await next_event(stream, ConnectionRestored)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.error is None
    assert len(fake.received("open")) == 4


async def test_settings_of_a_channel_that_waits_for_a_restarted_server_are_no_error(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 1
    await fake.drop()
    await until(lambda: channel.error is not None)
    channel.set(adverbs={"x": 0.75})
    await until(lambda: fake.received("set"))
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert fake.received("open")[-1]["adverbs"]["x"] == 0.75
    assert not [event for event in stream.take_events() if isinstance(event, CommandRejected)]


async def test_a_switch_of_a_channel_that_waits_for_a_restarted_server_succeeds(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 3
    await fake.drop()
    await until(lambda: channel.error is not None)
    switching = asyncio.create_task(stream.switch(channel, "board"))
    await until(lambda: len(fake.received("open")) == 5)  # three of them are rejected while the switch waits
    assert (await switching).verb == "board"
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert fake.received("open")[-1]["verb"] == "board"
    assert (channel.verb, channel.error) == ("board", None)


async def test_the_error_of_an_earlier_setting_is_no_answer_to_open(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 1
    await fake.drop()
    await until(lambda: channel.error is not None)
    channel.set(adverbs={"x": 0.75})
    await stream.close_channel(channel)
    again = await stream.open("reach", number=channel.number, adverbs=AT)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert again.opened is not None


async def test_a_repeated_open_of_an_open_channel_is_no_event(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    stream._outbox.put(None, channel.open_message())  # as a reconnection and a request that waits may do
    await until(lambda: len(fake.received("open")) == 2)
    await stream.ping()
    assert not [event for event in stream.take_events() if isinstance(event, CommandRejected)]


async def test_the_error_of_an_open_of_a_closed_channel_is_no_answer_to_the_next_one(stream, fake):
    """The first open was repeated, and its repetition is rejected after the channel is closed."""
    channel = await stream.open("reach", adverbs=AT)
    stream._outbox.put(None, channel.open_message())
    await stream.close_channel(channel)
    again = await stream.open("reach", number=channel.number, adverbs=AT)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert again.opened is not None
    assert not [event for event in stream.take_events() if isinstance(event, CommandRejected)]


async def test_a_channel_that_was_not_ready_is_not_opened_twice(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 1
    await fake.drop()
    await until(lambda: channel.error is not None)
    stream._outbox.put(None, channel.open_message())
    await until(lambda: channel.error is None)
    stream._session.retry_not_ready()
    await stream.ping()
    assert len(fake.received("open")) == 3


async def test_an_open_that_another_one_has_overtaken_succeeds(stream, fake):
    fake.not_ready = 1
    opening = asyncio.create_task(stream.open("reach", number=3, adverbs=AT))
    await until(lambda: fake.received("open") and not stream._session.pending)  # rejected, and repeated after a pause
    stream._outbox.put(None, stream.channels[3].open_message())
    await until(lambda: stream.channels[3].opened is not None)
    assert (await opening).number == 3
    assert len(fake.received("open")) == 3


async def test_an_open_during_a_connection_loss_succeeds(stream, fake):
    await stream.open("reach", adverbs=AT)
    fake.mute.add("open")
    opening = asyncio.create_task(stream.open("board"))
    await until(lambda: len(fake.received("open")) == 2)
    fake.mute.clear()
    await fake.drop()
    assert (await opening).verb == "board"


async def test_a_drain_is_an_event_and_delays_the_reconnection(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await fake.drain(0.2)
    assert (await next_event(stream, ServerDraining)).reconnect_after_s == 0.2
    lost = await next_event(stream, ConnectionLost)
    assert lost.close_code == 1012
    found = await next_event(stream, ConnectionRestored)
    assert 0.19 < found.outage_s < 2.0
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count)
    assert channel.opened.resumed


async def test_a_session_resumed_by_another_connection_ends_the_stream(stream, fake):
    await stream.open("reach", adverbs=AT)
    await fake.drop(4009)
    closed = await next_event(stream, StreamEnded)
    assert closed.close_code == 4009
    assert stream.closed
    with pytest.raises(StreamClosed):
        await stream.open("reach")
    assert [event async for event in stream] == []


async def test_connecting_to_a_full_server_is_repeated(fake):
    fake.close_code = 4029
    with pytest.raises(TimedOut, match="4029"):
        await Stream(fake.url, backoff=quick()).connect(timeout_s=0.1)
    stream = Stream(fake.url, backoff=quick())
    refused = fake.refused
    connecting = asyncio.create_task(stream.connect())
    await until(lambda: fake.refused >= refused + 2)
    fake.close_code = None
    await connecting
    assert stream.live
    await stream.close()


async def test_reconnection_ends_after_its_timeout(fake):
    async with Stream(fake.url, backoff=quick(), reconnect_timeout_s=0.1) as stream:
        await stream.open("reach", adverbs=AT)
        fake.close_code = 4029
        await fake.drop()
        assert "no reconnection within 0.1 s" in (await next_event(stream, StreamEnded)).detail


async def test_a_connection_timeout_has_the_cause():
    async with running() as fake:
        port = fake.port
    with pytest.raises(TimedOut, match="OSError|ConnectionRefused|Connect call failed"):
        await Stream(f"http://127.0.0.1:{port}", backoff=quick()).connect(timeout_s=0.2)


async def test_a_server_without_the_protocol_is_not_retried(fake):
    fake.protocols = []
    with pytest.raises(StreamClosed, match=r"does not support adverb\.v1"):
        await Stream(fake.url, backoff=quick()).connect()
