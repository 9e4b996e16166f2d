"""`send: "changes"`: a record only where more than phase and time differs."""

import json

import numpy as np
import pytest

from service.stream import rest
from tests.service.stream.conftest import Message, open_stream

pytestmark = pytest.mark.anyio

REACH, NEAR = {"x": -0.3, "y": 1.2, "z": 0.45}, {"x": -0.1, "y": 1.1, "z": 0.45}
RECIPE = {"encoding": "weights", "send": "changes", "events": False}


@pytest.fixture
def no_keys(monkeypatch):
    """No record is sent because of its age."""
    monkeypatch.setattr(rest, "KEY_S", 1e9)


async def records(client, channel, ticks=40):
    """Records of a channel in so many messages of another one, which is sent in every tick."""
    frames = [frame for frame in await client.poses(ticks) if isinstance(frame, Message)]
    return [found for frame in frames if (found := frame.of(channel)) is not None]


@pytest.fixture
async def stream(server, anyio_backend):
    """A stream with a channel 9 that is sent in every tick."""
    async with open_stream(server) as client:
        await client.open(9, "sway", encoding="q48", events=False)
        await client.poses(2)
        yield client


async def test_a_motion_with_constant_weights_needs_one_record(stream, no_keys):
    await stream.open(1, "sway", **RECIPE)
    first = await records(stream, 1)
    assert len(first) == 1
    assert first[0].weights.sum() == pytest.approx(1.0, abs=1e-5)
    assert await records(stream, 1) == []
    last = stream.frames[-1]
    assert last.sequence - stream.frames[0].sequence == len(stream.frames) - 1
    assert last.dropped == stream.frames[0].dropped


async def test_a_goal_is_followed_by_records_until_it_is_reached(stream, no_keys):
    await stream.open(1, "reach", adverbs=REACH, phase=0.1, play=False, **RECIPE)
    await stream.open(2, "reach", adverbs=REACH, phase=0.1, play=False, encoding="weights", events=False)
    await records(stream, 1)
    for channel in (1, 2):
        await stream.send("set", channel=channel, adverbs=NEAR, half_life=0.05)
    moving = await records(stream, 1, 30)
    assert len(moving) > 5
    settled = [len(await records(stream, 1, 30)) for _ in range(12)]
    assert settled[-1] == 0
    newest = next(found for frame in reversed(stream.frames) if (found := frame.of(1)) is not None)
    np.testing.assert_array_equal(newest.weights, stream.frames[-1].of(2).weights)


@pytest.mark.parametrize("change", [{"speed": 0.5}, {"phase": 0.2}, {"play": False}])
async def test_settings_of_time_are_followed_by_a_record(stream, no_keys, change):
    await stream.open(1, "sway", **RECIPE)
    await records(stream, 1)
    await stream.send("set", channel=1, **change)
    (found,) = await records(stream, 1)
    if "phase" in change:
        assert found.phase == pytest.approx(0.2, abs=0.05)


async def test_keys_are_sent_from_time_to_time(stream, monkeypatch):
    monkeypatch.setattr(rest, "KEY_S", 0.2)
    await stream.open(1, "sway", **RECIPE)
    found = await records(stream, 1, 90)
    assert 3 <= len(found) <= 12
    assert found[0].phase != found[-1].phase


async def test_the_end_and_a_switch_are_sent(stream, no_keys):
    await stream.open(1, "reach", adverbs=REACH, phase=0.9, **RECIPE)
    await stream.until("end", channel=1)
    await stream.poses(10)
    found = [record for frame in stream.frames if (record := frame.of(1)) is not None]
    assert [record.phase for record in found if record.flags & 8] == [1.0]
    await stream.socket.send(json.dumps({"op": "switch", "channel": 1, "verb": "punch"}))
    await stream.until("opened", channel=1)
    flags = [record.flags for record in await records(stream, 1, 90)]
    assert 2 in flags  # in transition
    assert flags[-1] == 0


async def test_other_channels_of_the_message_are_whole(stream, no_keys):
    """Their padding is zero, although records have moved within the buffer."""
    await stream.open(1, "sway", **RECIPE)
    await stream.open(10, "arm3", encoding="q48", events=False)
    await stream.open(11, "arm3", encoding="f32", events=False)
    frames = await stream.poses(30)
    assert all(frame.of(9) and frame.of(10) and frame.of(11) for frame in frames[5:])
    for frame in frames[5:]:
        np.testing.assert_allclose(frame.of(10).rotations, frame.of(11).rotations, atol=3e-4)


async def test_a_resumed_stream_gets_a_record_again(server, no_keys):
    async with open_stream(server) as client:
        await client.open(9, "sway", encoding="q48", events=False)
        await client.open(1, "sway", **RECIPE)
        await records(client, 1)
        session, sequence, opened = client.hello["session"], client.frames[-1].sequence, (client.lengths, client.joints)
        client.socket.transport.abort()
    async with open_stream(server) as client:
        client.lengths, client.joints = opened
        await client.send("resume", session=session, last_seq=sequence)
        assert len(await records(client, 1)) == 1


async def test_only_weights_can_be_sent_by_changes(stream):
    await stream.send("open", channel=1, verb="reach", send="changes")
    error = await stream.until("error")
    assert error["code"] == "bad_message"
    assert "weights" in error["detail"]
