"""Another version of a verb appears while it is streamed."""

from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import pytest

from service.catalog.catalog import Catalog, Entry
from tests.service.stream.conftest import open_stream
from verbs.verb import Basis

pytestmark = pytest.mark.anyio

IN_TRANSITION, NEW_VERSION = 2, 4
REACH = {"x": -0.3, "y": 1.2, "z": 0.45}


def with_version(catalog, name, version, **changes):
    """The catalog with another version of one verb."""
    was = catalog.entries[name]
    entry = Entry.of_verb(replace(was.verb, **changes), path=was.path, version=version)
    return Catalog(MappingProxyType({**catalog.entries, name: entry}), ())


def other_basis(verb) -> dict[str, Basis]:
    """Bases in which the smooth one is the plain one: other weights everywhere between the examples."""
    return {**verb.bases, "smooth": verb.bases["rbf"]}


async def test_a_new_version_appears_between_two_frames(serve, catalog):
    with serve() as server:
        async with open_stream(server) as client:
            opened = await client.open(1, "reach", adverbs=REACH)
            await client.open(2, "arm3")
            await client.poses(10)
            newer = with_version(catalog, "reach", 2, bases=other_basis(catalog.entries["reach"].verb))
            server.call(server.state.set_catalog, newer)
            reply = await client.until("version")
            await client.poses(20)
    assert (opened["version"], reply["version"], reply["channel"]) == (1, 2, 1)
    records = [frame.of(1) for frame in client.frames]
    versions = [record.version for record in records]
    assert versions == sorted(versions)
    flagged = [record for record in records if record.flags & NEW_VERSION]
    assert [record.version for record in flagged] == [2]
    assert flagged[0].flags & IN_TRANSITION
    passed_s = np.diff([frame.time_ns for frame in client.frames]) / 1e9  # a busy machine misses ticks
    pace = (np.diff([record.phase for record in records]) / passed_s)[[record.phase < 1.0 for record in records[1:]]]
    assert pace.std() < 0.2 * pace.mean()
    speeds = [np.abs(a.rotations - b.rotations).max() for a, b in pairwise(records)] / passed_s
    assert max(speeds) < 3 * np.median(speeds) + 0.6
    assert all(frame.of(2).version == 1 for frame in client.frames if frame.of(2))
    assert np.all(np.diff([frame.sequence for frame in client.frames]) == 1)


async def test_a_version_that_cannot_go_on_is_told_and_the_old_one_stays(serve, catalog):
    with serve() as server:
        async with open_stream(server) as client:
            await client.open(1, "arm3")
            await client.poses(2)
            verb = catalog.entries["board"].verb
            other = replace(verb, name="arm3")
            entry = Entry.of_verb(other, path=catalog.entries["board"].path, version=2)
            server.call(server.state.set_catalog, Catalog(MappingProxyType({**catalog.entries, "arm3": entry}), ()))
            error = await client.until("error")
            frames = await client.poses(5)
    assert error["channel"] == 1
    assert "version 2 of 'arm3' cannot continue this channel" in error["detail"]
    assert {frame.of(1).version for frame in frames} == {1}


async def test_each_character_of_a_crowd_has_one_record_with_the_flag_of_a_new_version(serve, catalog):
    count = 60
    with serve() as server:
        async with open_stream(server, max_size=None) as client:
            for number in range(count):
                await client.open(number, "arm3", fps=30)
            await client.poses(4)
            newer = with_version(catalog, "arm3", 2, bases=other_basis(catalog.entries["arm3"].verb))
            server.call(server.state.set_catalog, newer)
            await client.until("version")
            await client.poses(8)
            for adverbs in ((0.5, 0.1), (0.3, 0.2)):
                for number in range(count):
                    await client.set_adverbs(number, *adverbs)
                await client.poses(10)
    for number in range(count):
        records = [found for frame in client.frames if (found := frame.of(number))]
        assert sum(bool(record.flags & NEW_VERSION) for record in records) == 1
        assert records[-1].version == 2
