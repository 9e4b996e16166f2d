"""Behaviour that the client requires of a stream server, on the simulated one and on the real one."""

import math

import numpy as np
import pytest
from adverb_client import KeytimePassed, MotionEnded, Stream, errors

from tests.clients.python.conftest import next_event, quick, until
from tests.clients.python.fake import FakeVerb, running

pytestmark = pytest.mark.anyio

AT = {"x": 0.4, "y": 0.3}


@pytest.fixture(params=["fake", "real"])
async def url(request, anyio_backend):
    if request.param == "fake":
        arm = FakeVerb({"x": (0.15, 0.75), "y": (-0.45, 0.45)}, looping=False, examples=9)
        async with running({"arm3": arm, "board": FakeVerb({"u": (-0.5, 0.5), "v": (-0.5, 0.5)})}) as fake:
            yield fake.url
        return
    yield request.getfixturevalue("address")


@pytest.fixture
async def stream(url):
    async with Stream(url, backoff=quick()) as stream:
        yield stream


@pytest.mark.parametrize("encoding", ["f32", "q48", "q32", "weights"])
async def test_every_encoding_is_decoded(stream, encoding):
    channel = await stream.open("arm3", adverbs=AT, encoding=encoding, phase=0.25, play=False)
    await until(lambda: channel.pose() is not None and stream.stats.messages > 3)
    sample = channel.pose()
    assert stream.stats.decode_errors == 0, stream.stats.last_error
    assert sample.phase == pytest.approx(0.25, abs=1e-6)
    if encoding == "weights":
        assert sample.weights.shape == (9,)
        assert sample.weights.sum() == pytest.approx(1.0, abs=1e-5)
    else:
        assert sample.rotations.shape == (len(channel.info.joints), 4)
        np.testing.assert_allclose(np.linalg.norm(sample.rotations, axis=-1), 1.0, atol=1e-6)


async def test_keytimes_and_the_end_are_events(stream):
    channel = await stream.open("arm3", adverbs=AT, loop=False, phase=0.4, speed=3.0)
    assert (await next_event(stream, KeytimePassed)).channel == channel.number
    assert (await next_event(stream, MotionEnded)).channel == channel.number
    await until(lambda: channel.pose().ended and channel.pose().phase == pytest.approx(1.0))
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 20)
    assert channel.pose().ended
    channel.set(phase=0.1, play=False)
    await until(lambda: not channel.pose().ended)


async def test_one_message_steers_several_channels(stream):
    options = {"adverbs": AT, "half_life": 0.0, "play": False, "phase": 0.5, "events": False}
    first, *others = [await stream.open("arm3", **options) for _ in range(4)]
    await until(lambda: all(channel.pose() is not None for channel in [first, *others]))
    before, goal = np.append(first.pose().root, first.pose().rotations), [0.3, 0.1]
    first.aim(goal)
    stream.aim_many(others, [goal] * 3)

    def moved(channel):
        return np.append(channel.pose().root, channel.pose().rotations)

    await until(lambda: np.abs(moved(first) - before).max() > 1e-2)
    await until(lambda: all(np.allclose(moved(channel), moved(first), atol=1e-5) for channel in others))


async def test_error_messages_have_their_codes_and_change_nothing(stream):
    channel = await stream.open("arm3", adverbs=AT)
    with pytest.raises(errors.UnknownVerb):
        await stream.open("no such verb")
    with pytest.raises(errors.UnknownVerb):
        await stream.switch(channel, "no such verb")
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.verb == "arm3"


async def test_a_closed_channel_gets_no_poses_and_its_number_is_free(stream):
    channel = await stream.open("arm3", adverbs=AT)
    other = await stream.open("arm3", adverbs=AT, encoding="q48")
    await stream.close_channel(channel)
    again = await stream.open("arm3", number=channel.number, adverbs=AT, encoding="weights")
    await until(lambda: other.pose() is not None and again.pose() is not None)
    assert again.pose().weights is not None
    assert stream.stats.decode_errors == 0, stream.stats.last_error


async def test_pings_give_clock_and_ages(stream):
    assert 0.0 < await stream.ping() < 2.0
    channel = await stream.open("arm3", adverbs=AT)
    await until(lambda: channel.pose() is not None and math.isfinite(stream.age_s))
    assert -0.05 < stream.age_s < 2.0


async def test_a_lost_connection_is_resumed(stream):
    channel = await stream.open("arm3", adverbs=AT, play=False, phase=0.25)
    await until(lambda: channel.pose() is not None)
    await _cut(stream)
    await until(lambda: stream.stats.resumes == 1)
    count = stream.stats.messages
    await until(lambda: stream.stats.messages > count + 3)
    assert channel.opened.resumed
    assert channel.pose().phase == pytest.approx(0.25, abs=1e-6)
    assert (stream.stats.decode_errors, stream.stats.stale) == (0, 0), stream.stats.last_error


async def _cut(stream: Stream) -> None:
    """Lose the connection without a close frame."""
    stream._connection.socket.transport.abort()


async def test_the_hand_of_a_held_channel_follows_its_goal(address, anyio_backend):
    async with Stream(address) as stream:
        channel = await stream.open("arm3", adverbs=AT, play=False, half_life=0.0)
        channel.set(phase=sum(channel.info.follow) / 2)
        for goal in ([0.5, 0.1], [0.3, -0.2]):
            channel.aim(goal)
            await until(lambda goal=goal: off(channel, goal) < 1e-4)
        assert channel.pose().error < 1e-4


def off(channel, goal) -> float:
    sample = channel.pose()
    if sample is None:
        return math.inf
    return float(np.linalg.norm(channel.positions(sample)[-1, :2] - goal))
