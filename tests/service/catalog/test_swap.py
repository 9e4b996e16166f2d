"""Versions change while a hundred streams run, without lost frames or jumps."""

import asyncio
import gc
import time
import weakref
from contextlib import AsyncExitStack
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.service.catalog.conftest import PATIENCE_S, Kept
from tests.service.stream.conftest import open_stream
from tests.verbs.sources import ANGLES, arm_source
from verbs.authoring.fit import build
from verbs.io import artifact
from verbs.runtime.characters import VERSION_S

pytestmark = [pytest.mark.anyio]

SOCKETS, VERSIONS = 100, 20
WATCHED = 2
"""Sockets that ask for rotations, 60 times a second; the others ask for weights, 5 times."""

HELD = {"adverbs": {"x": 0.4, "y": 0.3}, "phase": 0.5, "play": False, "method": "rbf"}
"""By `corrected` both versions would reach the goal, and with two joints in the one way that there is."""

STEEPEST = 12.0
"""Largest acceleration of a cross-fade over a way of 1 in a time of 1; a jump has 1 / frame², ten times more."""


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    """A verb with all its examples, and with one less: other weights, another pose at the same adverbs."""
    folder = tmp_path_factory.mktemp("arms")
    angles = [ANGLES, dict(list(ANGLES.items())[:-1])]
    return [build(arm_source(folder / f"arm{k}", angles=some)).verb for k, some in enumerate(angles)]


@pytest.fixture(scope="module")
def server(tmp_path_factory, arms):
    folder = tmp_path_factory.mktemp("swap")
    artifact.save(arms[0], folder / "arm.verb")
    server = Kept(data=folder, refiners=0).start(PATIENCE_S)
    yield server
    server.stop()


async def test_twenty_versions_come_and_go_under_a_hundred_streams(server, arms, tmp_path):
    examples = {1: len(arms[0].examples)}
    async with AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(open_stream(server)) for _ in range(SOCKETS)]
        for k, client in enumerate(clients):
            how = {"encoding": "f32", "fps": 60} if k < WATCHED else {"encoding": "weights", "fps": 5}
            await client.open(1, "arm", **HELD, **how)
        reading = [asyncio.create_task(read_on(client)) for client in clients]
        await shown(clients, reading, 1)
        for k in range(VERSIONS):
            verb = replace(arms[(k + 1) % 2], description=f"number {k}")
            number = await asyncio.to_thread(publish, server, verb, tmp_path / "arm.verb")
            examples[number] = len(verb.examples)
            await shown(clients, reading, number)
            if k % 4 == 3:
                back = number - 1
                await asyncio.to_thread(
                    server.state.store_sync.store.activate, "arm", back, author="test", reason="back"
                )
                await shown(clients, reading, back)
        await asyncio.gather(*(client.socket.close() for client in clients))
        await asyncio.gather(*reading, return_exceptions=True)
    assert sorted(examples) == list(range(1, VERSIONS + 2))
    assert set(examples.values()) == {4, 5}
    for k, client in enumerate(clients):
        announced(client, examples, weights=k >= WATCHED)
        assert all(b.sequence == a.sequence + 1 for a, b in pairwise(client.frames))
    for client in clients[:WATCHED]:
        smooth(client)


def publish(server, verb, path):
    artifact.save(verb, path)
    store = server.state.store_sync.store
    return store.publish("arm", path, author="test", reason="swap", quality={}).number


async def read_on(client):
    while True:
        await client.read()


async def shown(clients, reading, number):
    """Wait until every stream shows a version, and its cross-fade is over."""

    def over(client):
        first = next((frame for frame in reversed(client.frames) if frame.of(1).version != number), None)
        last = client.frames[-1] if client.frames else None
        if last is None or last.of(1).version != number:
            return False
        return first is None or last.time_ns > first.time_ns + 2e9 * VERSION_S

    for client in clients:
        async with asyncio.timeout(PATIENCE_S):
            while not over(client):
                for task in reading:
                    assert not task.done(), task.exception()
                await asyncio.sleep(0.05)


def announced(client, examples, *, weights):
    """Every record has the version and the length that were announced last."""
    reply = [text["version"] for text in client.texts if text["op"] in ("opened", "version")]
    seen = [frame.of(1).version for frame in client.frames]
    changes = seen[:1] + [b for a, b in pairwise(seen) if a != b]
    assert changes == reply
    if weights:
        for frame in client.frames:
            assert len(frame.of(1).weights) == examples[frame.of(1).version]


def smooth(client):
    """The pose is held, so whatever moves is a cross-fade; it must be one."""
    times = np.array([frame.time_ns for frame in client.frames]) * 1e-9
    poses = np.array([frame.of(1).rotations for frame in client.frames], np.float64).reshape(len(times), -1)
    steps = np.diff(poses, axis=0) / np.diff(times)[:, None]
    accelerations = 2.0 * np.abs(np.diff(steps, axis=0)).max(axis=1) / (times[2:] - times[:-2])
    way = np.ptp(poses, axis=0).max()
    assert way > 0.01
    dropped = np.array([frame.dropped for frame in client.frames])
    accelerations = accelerations[dropped[2:] == dropped[:-2]]  # a frame after missed ones bears the first one's time
    assert accelerations.max() < STEEPEST * way / VERSION_S**2
    assert STEEPEST / VERSION_S**2 < 0.2 * 60**2  # so that a jump could not pass


def test_a_version_from_the_start_is_freed_when_it_is_replaced(arms, tmp_path):
    artifact.save(arms[0], tmp_path / "arm.verb")
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    gc.disable()  # a server collects rarely
    try:
        first = weakref.ref(server.state.current().entries["arm"].evaluator)
        publish(server, arms[1], tmp_path / "next")
        end = time.monotonic() + PATIENCE_S
        while first() is not None:
            assert time.monotonic() < end, "it is still in memory"
            time.sleep(0.02)
        assert server.state.current().entries["arm"].version == 2
    finally:
        gc.enable()
        server.stop()
