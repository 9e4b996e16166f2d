"""The stream loses its connection, and what it does then, against a small server over a real socket."""

import asyncio

import pytest
from adverb_client import Closed, Draining, Found, Lost, Stream, StreamClosed, TimedOut

from tests.clients.python.conftest import next_note, quick, until
from tests.clients.python.fake import running

pytestmark = pytest.mark.anyio

AT = {"x": 0.5, "y": 1.0, "z": 0.5}


async def test_a_lost_connection_is_found_again_and_the_session_goes_on(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await until(lambda: channel.pose() is not None)
    await fake.drop()
    await next_note(stream, Lost)
    channel.set(adverbs={"x": -0.75})  # while nobody listens
    found = await next_note(stream, Found)
    assert found.resumed
    resume = fake.said("resume")[0]
    assert resume["session"] == "s1"
    assert resume["last_seq"] > 0
    await until(lambda: abs(channel.pose().root[0] + 0.75) < 1e-6)
    assert (stream.stats.reconnects, stream.stats.resumes) == (1, 1)
    assert len(fake.said("open")) == 1
    assert stream.stats.decode_errors == 0


async def test_an_unknown_session_is_opened_anew_where_it_was(stream, fake):
    channel = await stream.open("reach", adverbs=AT, encoding="q48", play=False, phase=0.3)
    other = await stream.open("reach", adverbs=AT)
    await stream.switch(other, "board", adverbs={"u": 0.1, "v": 0.2})
    channel.aim([0.25, 1.5, 0.75])
    await until(lambda: channel.pose() is not None and abs(channel.pose().root[0] - 0.25) < 1e-6)
    fake.forget()
    await fake.drop()
    found = await next_note(stream, Found)
    assert not found.resumed
    await until(lambda: len(fake.said("open")) == 4)
    again, board = fake.said("open")[-2:]
    assert again["adverbs"] == {"x": 0.25, "y": 1.5, "z": 0.75}
    assert (again["encoding"], again["play"]) == ("q48", False)
    assert again["phase"] == pytest.approx(0.3, abs=1e-6)
    assert (board["verb"], board["adverbs"]) == ("board", {"u": 0.1, "v": 0.2})
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.pose().root[0] == pytest.approx(0.25)
    assert not channel.pose().held  # the other clock, an hour ahead, is the one that counts
    assert stream.stats.stale == 0
    assert stream.clock.offset_s == pytest.approx(fake.now_ns() * 1e-9 - stream.now(), abs=0.05)


async def test_adverbs_that_are_known_in_part_are_set_after_a_channel_is_opened_anew(stream, fake):
    channel = await stream.open("reach")
    channel.set(adverbs={"x": 0.75})
    await until(lambda: fake.said("set"))
    fake.forget()
    await fake.drop()
    await until(lambda: len(fake.said("set")) == 2)
    assert "adverbs" not in fake.said("open")[-1]  # an open takes all or none
    assert fake.said("set")[-1]["adverbs"] == {"x": 0.75}


async def test_a_server_that_comes_back_before_it_is_ready_is_asked_until_it_is(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    fake.forget()
    fake.not_ready = 2
    await fake.drop()
    await next_note(stream, Found)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.refused is None
    assert len(fake.said("open")) == 4


async def test_a_channel_that_was_asked_for_while_the_connection_broke_is_opened(stream, fake):
    await stream.open("reach", adverbs=AT)
    fake.mute.add("open")
    opening = asyncio.create_task(stream.open("board"))
    await until(lambda: len(fake.said("open")) == 2)
    fake.mute.clear()
    await fake.drop()
    assert (await opening).verb == "board"


async def test_a_drain_is_told_and_kept_to(stream, fake):
    channel = await stream.open("reach", adverbs=AT)
    await fake.drain(0.2)
    assert (await next_note(stream, Draining)).reconnect_after_s == 0.2
    lost = await next_note(stream, Lost)
    assert lost.close_code == 1012
    found = await next_note(stream, Found)
    assert 0.19 < found.away_s < 2.0
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count)
    assert channel.opened.resumed


async def test_a_session_that_was_resumed_elsewhere_is_left_alone(stream, fake):
    await stream.open("reach", adverbs=AT)
    await fake.drop(4009)
    closed = await next_note(stream, Closed)
    assert closed.close_code == 4009
    assert stream.closed
    with pytest.raises(StreamClosed):
        await stream.open("reach")
    assert [note async for note in stream] == []


async def test_a_server_that_is_full_is_tried_again_until_it_has_room(fake):
    fake.refuse_as = 4029
    with pytest.raises(TimedOut, match="4029"):
        await Stream(fake.url, backoff=quick()).connect(timeout_s=0.1)
    stream = Stream(fake.url, backoff=quick())
    connecting = asyncio.create_task(stream.connect())
    await asyncio.sleep(0.05)
    fake.refuse_as = None
    await connecting
    assert stream.live
    await stream.close()


async def test_a_server_that_does_not_come_back_is_given_up(fake):
    async with Stream(fake.url, backoff=quick(), give_up_s=0.1) as stream:
        await stream.open("reach", adverbs=AT)
        fake.refuse_as = 4029
        await fake.drop()
        assert "not back within 0.1 s" in (await next_note(stream, Closed)).detail


async def test_nobody_there_is_a_timeout_that_says_why():
    async with running() as fake:
        port = fake.port
    with pytest.raises(TimedOut, match="OSError|ConnectionRefused|Connect call failed"):
        await Stream(f"http://127.0.0.1:{port}", backoff=quick()).connect(timeout_s=0.2)


async def test_a_server_of_another_protocol_is_not_tried_twice(fake):
    fake.protocols = []
    with pytest.raises(StreamClosed, match=r"does not speak adverb\.v1"):
        await Stream(fake.url, backoff=quick()).connect()
