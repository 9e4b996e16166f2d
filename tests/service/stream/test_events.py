"""Events of a tick come in one message per socket, and only for channels that want them."""

import pytest

from tests.service.stream.conftest import Message, open_stream

pytestmark = pytest.mark.anyio


async def test_events_of_one_tick_are_one_message_before_its_poses(server):
    async with open_stream(server) as client:
        for number in range(12):
            await client.open(number, "arm3", fps=30, play=False, phase=0.4)
        await client.send("open", channel=20, verb="arm3", fps=30, play=False, phase=0.4, events=False)
        await client.until("opened", channel=20)
        for number in (*range(12), 20):
            await client.send("set", channel=number, play=True, speed=1)
        await client.send("ping", t=1)
        await client.until("pong")
        ends = set()
        while len(ends) < 13:
            message = await client.read()
            if not isinstance(message, Message) and message["op"] == "end":
                ends.add(message["channel"])
    events = [text for text in client.texts if text["op"] == "events"]
    items = [item for message in events for item in message["items"]]
    assert {item["channel"] for item in items} == set(range(12))
    assert {item["name"] for item in items} == {"reach", "end"}
    assert len(events) < 12  # all of a tick together; the channels started within a few ticks
    assert all({"channel", "name", "phase"} == item.keys() for item in items)


async def test_events_of_several_channels_are_in_the_order_of_each_motion(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", speed=10, fps=10)
        await client.open(2, "reach", speed=10, fps=10)
        await client.until("end", channel=2)
    for channel in (1, 2):
        names = [
            item["name"]
            for text in client.texts
            if text["op"] == "events"
            for item in text["items"]
            if item["channel"] == channel
        ]
        assert names == ["start", "apex", "end"]
