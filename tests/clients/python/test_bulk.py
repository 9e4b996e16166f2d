"""Goals of many channels in one message, and the byte budget."""

import asyncio

import numpy as np
import pytest
from adverb_client import BudgetReport, CommandRejected, encode_bulk_adverbs

from tests.clients.python.conftest import next_event, until

AT = {"x": 0.5, "y": 1.0, "z": 0.5}


def sent(fake):
    """Rows of each message 0x11."""
    return [row[2] for row in fake.messages if isinstance(row, tuple) and row[0] == 0x11]


async def opened(stream, count, verb="reach"):
    return [await stream.open(verb) for _ in range(count)]


def grid(count, width=3):
    return np.linspace(0.0, 0.5, count * width).reshape(count, width).astype(np.float32)


@pytest.mark.anyio
async def test_one_message_steers_many_channels(stream, fake):
    channels, goals = await opened(stream, 5), grid(5)
    stream.aim_many(channels, goals)
    await stream.ping()
    assert sent(fake) == [[(k, row) for k, row in enumerate(goals.tolist())]]
    await until(lambda: all(c.pose() is not None and c.pose().root[0] == goals[k, 0] for k, c in enumerate(channels)))
    stream.aim_many(np.array([3, 1]), goals[:2])
    stream.aim_many([], np.zeros((0, 3)))
    await stream.ping()
    assert sent(fake)[1:] == [[(3, goals[0].tolist()), (1, goals[1].tolist())]]


@pytest.mark.anyio
async def test_verbs_with_other_numbers_of_adverbs_get_their_own_message(stream, fake):
    reach, board = await opened(stream, 2), await opened(stream, 1, "board")
    stream.aim_many([reach[0], board[0], reach[1]], [[0.0, 1.0, 0.5], [0.25, -0.25], [0.5, 1.0, 0.5]])
    await stream.ping()
    assert sent(fake) == [[(0, [0.0, 1.0, 0.5]), (1, [0.5, 1.0, 0.5])], [(2, [0.25, -0.25])]]


@pytest.mark.anyio
async def test_invalid_goals_raise_and_nothing_is_sent(stream, fake):
    channels = await opened(stream, 2)
    for numbers, goals, reason in [
        (channels, grid(2, 2), "2 adverbs given; channel 0 has 3"),
        (channels, grid(3), "3 rows of adverbs for 2 channels"),
        ([0, 9], grid(2), "channel 9 is not open"),
        ([0, 70_000], grid(2), "expected 0 to 65,535"),
        (channels, np.full((2, 3), np.nan), "must be finite"),
        (channels, np.full((2, 3), 1.1e9), "at most 1e"),
        (channels, np.zeros(2), r"expected \(B,\) and \(B, D\)"),
    ]:
        with pytest.raises(ValueError, match=reason):
            stream.aim_many(numbers, goals)
    await stream.close_channel(channels[1])
    with pytest.raises(ValueError, match="channel 1 is not open"):
        stream.aim_many([0, 1], grid(2))
    await stream.ping()
    assert sent(fake) == []


def test_messages_hold_at_most_64_kib():
    messages = encode_bulk_adverbs(np.arange(10_000), np.zeros((10_000, 3)))
    assert [len(message) for message in messages] == [4 + 16 * 4_095, 4 + 16 * 4_095, 4 + 16 * 1_810]
    assert messages[1][4:6] == (4_095).to_bytes(2, "little")


@pytest.mark.anyio
async def test_goals_survive_a_reconnection(stream, fake):
    channels, goals = await opened(stream, 3), grid(3)
    stream.aim_many(channels, goals)
    channels[2].aim([0.125, 1.0, 0.5])
    channels[1].set(adverbs={"y": 1.5})
    await stream.ping()
    before = len(fake.received("open"))
    fake.forget()
    await fake.drop()
    await until(lambda: len(fake.received("open")) == before + 3)
    reopened = {row["channel"]: list(row["adverbs"].values()) for row in fake.received("open")[before:]}
    assert reopened[0] == goals[0].tolist()
    assert reopened[1] == [goals[1, 0], 1.5, goals[1, 2]]
    assert reopened[2] == [0.125, 1.0, 0.5]


@pytest.mark.anyio
async def test_a_goal_during_a_switch_follows_its_answer(stream, fake):
    channels = await opened(stream, 2)
    stream.aim_many(channels, grid(2))
    await stream.ping()
    switching = asyncio.create_task(stream.switch(channels[1], "board"))
    await asyncio.sleep(0)  # the switch is sent, and has no answer yet
    assert channels[1].switch is not None
    stream.aim_many([channels[0], channels[1]], [[0.0, 1.0, 0.5], [0.25, 0.5]])
    await switching
    await stream.ping()
    assert sent(fake)[-1] == [(0, [0.0, 1.0, 0.5])]
    assert fake.messages[-2] == (0x10, 1, [0.25, 0.5])  # before the ping
    with pytest.raises(ValueError, match="3 adverbs given; channel 1 has 2"):
        stream.aim_many(channels, grid(2))


@pytest.mark.anyio
async def test_the_view_is_sent_again_after_a_reconnection(stream, fake):
    await stream.open("reach", adverbs=AT, priority=2.0, events=False)
    assert (fake.received("open")[0]["priority"], fake.received("open")[0]["events"]) == (2.0, False)
    stream.view([1.0, 1.7, -4.0], budget_kbps=500)
    report = await next_event(stream, BudgetReport)
    assert (report.kbps, report.budget_kbps, report.left_out, report.min_fps) == (250.0, 500.0, 40, 6.0)
    for forget in (False, True):
        before = len(fake.received("view"))
        if forget:
            fake.forget()
        await fake.drop()
        await until(lambda before=before: len(fake.received("view")) > before)
    assert all(
        row == {"op": "view", "x": 1.0, "y": 1.7, "z": -4.0, "budget_kbps": 500.0} for row in fake.received("view")
    )
    assert not [event for event in stream.take_events() if isinstance(event, CommandRejected)]


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("position", "budget", "reason"),
    [
        (None, 0.5, "budget_kbps 0.5; expected 1 to 10000000"),
        ([2e9, 0, 0], None, "x 2000000000.0"),
        ([1, 2], 5, "shorter than"),
    ],
)
async def test_an_invalid_view_raises(stream, position, budget, reason):
    with pytest.raises(ValueError, match=reason):
        stream.view(position, budget_kbps=budget)


@pytest.mark.anyio
async def test_an_invalid_priority_raises(stream):
    channel = await stream.open("reach")
    for priority in (0, -1.0, 1000.5):
        with pytest.raises(ValueError, match="priority"):
            channel.set(priority=priority)
