"""What happens to streams when clients are slow, vanish or come back, and when the server stops."""

import asyncio
import json
import time

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from tests.service.stream.conftest import eventually, open_stream

pytestmark = pytest.mark.anyio

REACH = {"x": -0.3, "y": 1.2, "z": 0.45}


async def drop(client):
    """Cut the connection without a word."""
    client.socket.transport.abort()
    await asyncio.sleep(0.05)


async def test_a_lost_session_goes_on_and_is_resumed(server):
    async with open_stream(server) as one:
        await one.open(3, "reach", adverbs=REACH, speed=0.5)
        await one.open(4, "arm3", play=False)
        before = (await one.poses(10))[-1]
        await drop(one)
    await asyncio.sleep(0.5)
    async with open_stream(server) as two:
        await two.open(9, "arm3")  # what it opened itself is closed
        await two.send("resume", session=one.hello["session"], last_seq=before.sequence)
        first = await two.until("opened", channel=3)
        await two.until("opened", channel=4)
        assert first["resumed"] is True
        two.frames.clear()
        after = (await two.poses(2))[-1]
        assert [record.channel for record in after.records] == [3, 4]
        assert after.sequence > before.sequence
        passed = (after.time_ns - before.time_ns) / 1e9
        assert after.of(3).time - before.of(3).time == pytest.approx(0.5 * passed, abs=1e-4)
        assert after.dropped >= 0.4 * 60
        frames = await two.poses(5)
        assert np.all(np.diff([frame.sequence for frame in frames]) == 1)
        await two.send("ping", t=0)
        await two.until("pong")


async def test_after_the_grace_time_a_session_is_gone(serve):
    with serve(stream_grace_s=0.3) as server:
        async with open_stream(server) as one:
            await one.open(1, "arm3")
            await one.poses(2)
            await drop(one)
        await eventually(lambda: not server.hub.sessions)
        assert server.hub.characters == 0
        async with open_stream(server) as two:
            await two.send("resume", session=one.hello["session"], last_seq=0)
            assert (await two.until("error"))["code"] == "unknown_session"
            await two.open(1, "arm3")


async def test_who_leaves_politely_is_not_waited_for(server):
    async with open_stream(server) as client:
        await client.open(1, "arm3")
        name = client.hello["session"]
    await eventually(lambda: name not in server.hub.sessions)


async def test_a_session_can_be_taken_over_while_its_connection_seems_alive(server):
    async with open_stream(server) as one:
        await one.open(1, "arm3")
        await one.poses(2)
        async with open_stream(server) as two:
            await two.send("resume", session=one.hello["session"], last_seq=2)
            await two.until("opened", channel=1)
            assert await two.poses(3)
            with pytest.raises(ConnectionClosed) as closed:
                await one.until("never")
            assert closed.value.rcvd.code == 4009
            assert (await two.poses(3))[-1].of(1)


async def test_a_slow_reader_holds_up_nobody_and_finds_fresh_frames(serve):
    with serve() as server:
        async with open_stream(server, max_size=None) as slow:
            for number in range(40):
                await slow.open(number, "reach", adverbs=REACH)
            others = [open_stream(server) for _ in range(99)]
            clients = [await one.__aenter__() for one in others]
            for client in clients:
                await client.open(0, "arm3", fps=30)
            await slow.poses(3)
            slow.socket.transport.pause_reading()
            paused_at = slow.frames[-1].time_ns
            await asyncio.gather(*(client.for_seconds(0.5) for client in clients))  # what came while they were opened
            for client in clients:
                client.frames.clear()
            await asyncio.gather(*(client.for_seconds(10.0) for client in clients))
            session = server.hub.sessions[slow.hello["session"]]
            kept = sum(len(frame) for frame in session.connection.pending)
            waiting = len(session.connection.pending)
            slow.socket.transport.resume_reading()
            slow.frames.clear()
            while not (slow.frames and slow.frames[-1].time_ns > time.time_ns() - 100_000_000):
                await slow.poses(1)
            last = slow.frames[-1]
            for one in others:
                await one.__aexit__(None, None, None)
    assert last.time_ns - paused_at > 10e9
    assert last.dropped > 200
    assert kept < 60_000  # a part of a message of 17 kB, and keytimes and ends of 40 motions
    assert waiting <= 4 * 40
    for client in clients:
        sequences = [frame.sequence for frame in client.frames]
        assert len(sequences) > 150  # of 300: ticks that a busy machine misses are stepped over
        assert np.all(np.diff(sequences) == 1)
        late = np.array([frame.arrived_ns - frame.time_ns for frame in client.frames]) / 1e9
        assert np.percentile(late, 50) < 0.1
        assert np.percentile(late, 99) < 1.0


async def test_who_reads_nothing_for_too_long_is_cut_off(serve):
    with serve(stream_slow_s=0.5) as server:
        async with open_stream(server, max_size=None) as slow:
            for number in range(60):
                await slow.open(number, "reach", adverbs=REACH, fps=120)
            slow.socket.transport.pause_reading()
            session = server.hub.sessions[slow.hello["session"]]
            await eventually(lambda: not session.connected)
            slow.socket.transport.resume_reading()
            with pytest.raises(ConnectionClosed) as closed:
                await slow.until("never")
        assert closed.value.rcvd.code == 4008
        assert "0.5 s" in closed.value.rcvd.reason


async def test_a_client_that_only_talks_is_not_heard_faster_than_it_reads(server):
    async with open_stream(server, max_size=None) as client:
        client.socket.transport.pause_reading()
        flood = asyncio.create_task(_flood(client, 20_000))
        await asyncio.sleep(1.0)
        async with open_stream(server) as other:
            await other.open(1, "arm3")
            frames = await other.poses(30)
            assert np.all(np.diff([frame.sequence for frame in frames]) == 1)
        connection = server.hub.sessions[client.hello["session"]].connection
        assert len(connection.pending) <= 256
        client.socket.transport.resume_reading()
        await flood
        pong = None
        while pong != 19_999:
            pong = (await client.until("pong"))["t"]


async def _flood(client, count):
    for number in range(count):
        await client.socket.send(json.dumps({"op": "ping", "t": number}))


async def test_a_stopping_server_says_so_and_closes(serve):
    with serve() as server:
        async with open_stream(server) as client:
            await client.open(1, "arm3")
            await client.poses(2)
            started = time.monotonic()
            server.uvicorn.should_exit = True
            drain = await client.until("drain")
            with pytest.raises(ConnectionClosed) as closed:
                await client.until("never")
        assert drain["reconnect_after_s"] > 0
        assert closed.value.rcvd.code == 1012
        await eventually(lambda: not server.thread.is_alive())
        assert time.monotonic() - started < 10


async def test_a_message_that_is_sent_in_part_is_finished_before_the_next(server):
    async with open_stream(server, max_size=None) as slow:
        for number in range(60):
            await slow.open(number, "reach", fps=120)
        slow.socket.transport.pause_reading()
        session = server.hub.sessions[slow.hello["session"]]
        await eventually(lambda: session.dropped > 100)
        slow.socket.transport.resume_reading()
        frames = await slow.poses(50)  # every one of them decodes to its last byte
        sequences = [frame.sequence for frame in frames]
        assert np.all(np.diff(sequences) == 1)
