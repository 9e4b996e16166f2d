"""The stream for programs without an event loop."""

import asyncio
import threading
import time

import pytest
from adverb_client import MotionEnded, StreamClosed, SyncStream, TimedOut, errors

from tests.clients.python.conftest import quick
from tests.clients.python.fake import running_aside

AT = {"x": 0.5, "y": 1.0, "z": 0.5}


@pytest.fixture(scope="module")
def server():
    with running_aside() as found:
        yield found


def until(true, within_s: float = 5.0) -> None:
    end = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end, "the condition is not met in time"
        time.sleep(0.005)


def test_methods_work_like_those_of_stream(server):
    fake, _ = server
    with SyncStream(fake.url) as stream:
        assert stream.live
        assert stream.hello.max_channels == 100
        channel = stream.open("reach", adverbs=AT)
        until(lambda: channel.pose() is not None)
        channel.aim([0.25, 1.0, 0.5])
        until(lambda: abs(stream.pose(channel).root[0] - 0.25) < 1e-6)
        assert 0.0 < stream.ping() < 1.0
        assert stream.clock.known
        assert stream.switch(channel, "once", adverbs={"x": 0.1}).verb == "once"
        until(lambda: any(isinstance(event, MotionEnded) for event in stream.take_events()))
        stream.close_channel(channel)
        assert not stream.channels
        assert stream.stats.decode_errors == 0
    assert stream.closed


def test_it_reconnects(server):
    fake, loop = server
    with SyncStream(fake.url, backoff=quick()) as stream:
        channel = stream.open("reach", adverbs=AT)
        until(lambda: channel.pose() is not None)
        asyncio.run_coroutine_threadsafe(fake.drop(), loop).result(5.0)
        until(lambda: stream.stats.resumes == 1)
        assert channel.pose() is not None


def test_several_threads_can_aim_and_read_poses(server):
    fake, _ = server
    with SyncStream(fake.url) as stream:
        channels = [stream.open("reach", adverbs=AT) for _ in range(4)]
        wrong = []

        def work(channel):
            try:
                for k in range(200):
                    channel.aim([k / 200, 1.0, 0.5])
                    channel.pose()
            except Exception as err:
                wrong.append(err)

        threads = [threading.Thread(target=work, args=(channel,)) for channel in channels]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not wrong
        until(lambda: all(c.pose() is not None and abs(c.pose().root[0] - 0.995) < 1e-6 for c in channels))


def test_errors_are_raised_and_the_thread_ends(server):
    fake, _ = server
    before = threading.active_count()
    stream = SyncStream(fake.url)
    with pytest.raises(RuntimeError, match="not connected yet"):
        stream.open("reach")
    with stream, pytest.raises(errors.UnknownVerb):
        stream.open("nothing")
    with pytest.raises(StreamClosed):
        stream.open("reach")
    with pytest.raises(RuntimeError, match="connected once"):
        stream.connect()
    stream.close()
    with pytest.raises(TimedOut):
        SyncStream("http://127.0.0.1:1", backoff=quick()).connect(timeout_s=0.05)
    assert threading.active_count() == before
