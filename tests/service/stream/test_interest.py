"""Byte budgets: the most important records are sent, and every channel in its turn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.stream.interest import NEAR_M, SAVED_S, Interest
from tests.service.stream.conftest import eventually, open_stream

pytestmark = pytest.mark.anyio

FIXED = 30


def run(interest, count, priorities, sizes, ticks, *, positions=None, step_s=1 / 60):
    """Chosen records (T, R) of so many ticks."""
    numbers = np.arange(count)
    positions = np.zeros((count, 3)) if positions is None else positions
    rows = [
        interest.choose(numbers, np.array(priorities, float), np.array(sizes), positions, fixed=FIXED, step_s=step_s)
        for _ in range(ticks)
    ]
    return np.array(rows)


@given(
    st.lists(st.tuples(st.floats(0.01, 1000), st.integers(60, 2000)), min_size=1, max_size=40),
    st.floats(1, 2000),
)
def test_no_budget_is_exceeded(channels, kbps):
    priorities, sizes = zip(*channels, strict=True)
    interest = Interest(kbps, None)
    ticks = 240
    chosen = run(interest, len(channels), priorities, sizes, ticks)
    used = (chosen * np.array(sizes)).sum(axis=1) + FIXED * (chosen.sum(axis=1) > 0)
    per_s = 125 * kbps
    most = max(SAVED_S * per_s, FIXED + max(sizes))
    for start in (0, 60):
        for stop in range(start + 1, ticks + 1, 20):
            assert used[start:stop].sum() <= most + per_s * (stop - start) / 60 + 1e-6


@given(st.lists(st.floats(0.01, 1000), min_size=2, max_size=20), st.integers(200, 2000))
def test_every_channel_is_sent_in_its_turn(priorities, size):
    count = len(priorities)
    kbps = 60 * (FIXED + 1.5 * size) / 125  # about one record a tick
    ratio = max(priorities) / min(priorities)
    ticks = int(min(count * (ratio + 2) * 2, 4000))
    chosen = run(Interest(kbps, None), count, priorities, [size] * count, ticks)
    if ticks < 4000:
        assert chosen.sum(axis=0).min() >= 1
    assert chosen.sum() >= 0.9 * min(ticks, 60)


def test_rates_follow_priorities():
    chosen = run(Interest(60 * (FIXED + 1000) / 125, None), 4, [1, 1, 2, 4], [500] * 4, 4000).sum(axis=0)
    assert chosen[0] == pytest.approx(chosen[1], rel=0.05)
    assert chosen[2] / chosen[0] == pytest.approx(2, rel=0.15)
    assert chosen[3] / chosen[0] == pytest.approx(4, rel=0.3)


def test_near_characters_are_sent_more_often_than_far_ones():
    positions = np.array([[0.0, 0, 0], [NEAR_M, 0, 0], [0, 0, 9 * NEAR_M]])
    interest = Interest(60 * (FIXED + 500) / 125, np.zeros(3))
    chosen = run(interest, 3, [1, 1, 1], [500] * 3, 3000, positions=positions).sum(axis=0)
    assert chosen[0] / chosen[1] == pytest.approx(2, rel=0.15)
    assert chosen[0] / chosen[2] == pytest.approx(10, rel=0.2)


def test_a_channel_that_comes_or_goes_leaves_the_others_as_they_are():
    interest = Interest(60 * (FIXED + 500) / 125, None)
    for numbers in ([3, 5], [3, 4, 5], [5], [2, 5, 9]):
        count = len(numbers)
        for _ in range(10):
            chosen = interest.choose(
                np.array(numbers), np.ones(count), np.full(count, 500), np.zeros((count, 3)), fixed=FIXED, step_s=1 / 60
            )
            assert chosen.sum() <= 2
    assert interest._numbers.tolist() == [2, 3, 4, 5, 9]


async def test_a_budget_is_kept_and_reported(server):
    async with open_stream(server) as client:
        for number in range(20):
            await client.open(number, "reach", fps=60, priority=4 if number < 5 else 1, encoding="q48")
        await client.send("set", channel=19, priority=4)
        await client.send("view", budget_kbps=400)
        await client.until("stats")
        client.frames.clear()
        stats = await client.until("stats")
        frames = list(client.frames)
        await client.send("view")
        await client.send("ping", t=1)
        await client.until("pong")
        after = (await client.poses(3))[-1]
    assert stats["budget_kbps"] == 400
    assert 200 < stats["kbps"] <= 440
    assert stats["left_out"] > 0
    assert 0 < stats["min_fps"] < stats["max_fps"] < 60
    counts = np.zeros(20)
    for frame in frames:
        for record in frame.records:
            counts[record.channel] += 1
    assert counts.min() >= 1
    assert counts[[0, 1, 2, 3, 4, 19]].mean() > 2.5 * counts[5:19].mean()
    assert stats["records"] == pytest.approx(counts.sum(), abs=2 * max(len(frame.records) for frame in frames) + 20)
    assert len(after.records) == 20
    assert np.all(np.diff([frame.sequence for frame in frames]) == 1)


async def test_characters_that_are_left_out_move_on(server):
    async with open_stream(server) as client:
        for number in range(10):
            await client.open(number, "arm3", fps=60, speed=0.5)
        await client.send("view", x=0, y=1, z=0, budget_kbps=60)
        await client.until("stats")
        frames = await client.poses(40)
    records = {}
    for frame in frames:
        for record in frame.records:
            records.setdefault(record.channel, []).append((frame.time_ns, record.time))
    (first_ns, first), (last_ns, last) = records[3][0], records[3][-1]
    assert last - first == pytest.approx(0.5 * (last_ns - first_ns) / 1e9, abs=1e-4) or last == records[3][-2][1]


async def test_a_resumed_session_keeps_its_budget(server):
    async with open_stream(server) as one:
        for number in range(10):
            await one.open(number, "arm3")
        await one.send("view", budget_kbps=100)
        await one.until("stats")
        one.socket.transport.abort()
    session = server.hub.sessions[one.hello["session"]]
    await eventually(lambda: not session.connected)
    async with open_stream(server) as two:
        await two.send("resume", session=one.hello["session"], last_seq=0)
        assert (await two.until("stats"))["budget_kbps"] == 100
