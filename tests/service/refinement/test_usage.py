"""Usage: counts of requested adverbs and errors, bounded, decaying and cheap."""

import time
from dataclasses import replace

import numpy as np
import pytest

from service.catalog.catalog import Entry
from service.refinement.usage import ERRORS_HALF_LIFE_S, FORGET_S, Usage
from service.refinement.usage_cells import CELLS, HALF_LIFE_S, cells_json, merge_cells
from service.stream.group import Group
from service.stream.sampling import MAX_SAMPLES, CharacterSampler
from tests.service.conftest import app_of, client_of
from verbs.domain import random_points
from verbs.goal import diagonal

NAMES = ("x", "y")


@pytest.fixture(scope="module")
def arm(catalog):
    return catalog.entries["arm3"]


def some(entry, count, seed=0):
    return random_points(entry.verb, np.random.default_rng(seed), count)


def counted(usage, now_s=0.0):
    usage.count(usage.take(), now_s)
    return usage.verbs


def total(observed):
    return observed.cells[1].sum()


def test_all_forms_of_adverbs_are_counted_alike(arm):
    rows = some(arm, 300)
    named = [dict(zip(NAMES, row, strict=True)) for row in rows.tolist()]
    reply = []
    for asks in ([(rows, 300)], [(named, 300)], [(one, 1) for one in named]):
        usage = Usage()
        for adverbs, count in asks:
            usage.record(arm, adverbs, rows=count)
        reply.append(counted(usage)["arm3"].to_json())
    assert reply[0] == reply[1] == reply[2] == {**cells_json(arm.verb, rows), "at_s": 0.0}


def test_counts_add_up_and_decay(arm):
    usage = Usage()
    usage.record(arm, some(arm, 40), rows=40)
    counted(usage)
    usage.record(arm, some(arm, 10, seed=1), rows=10)
    assert total(counted(usage, HALF_LIFE_S)["arm3"]) == pytest.approx(30)
    usage.record(arm, some(arm, 1), rows=1)
    assert total(counted(usage, HALF_LIFE_S)["arm3"]) == pytest.approx(31)


def test_records_and_cells_are_bounded(arm):
    usage = Usage(limit=100)
    for k in range(50):
        usage.record(arm, some(arm, 60, seed=k), rows=60)
    assert total(counted(usage)["arm3"]) == 120
    for k in range(10):
        usage.record(arm, some(arm, 3_000, seed=k), rows=3_000)
        counted(usage)
    assert len(usage.verbs["arm3"].cells[1]) <= CELLS**2
    silent = Usage(limit=0)
    silent.record(arm, some(arm, 1))
    assert silent.take() == []


def test_adverbs_outside_the_domain_are_counted_after_clamping(arm):
    usage, outside = Usage(), np.array([[1e6, -1e6]])
    usage.record(arm, outside)
    inside, moved = arm.evaluator.clamp(outside)
    assert moved.all()
    (cell,) = counted(usage)["arm3"].to_json()["cells"]
    assert cell == cells_json(arm.verb, inside)["cells"][0]


def test_errors_are_shares_of_the_diagonal_and_decay(arm):
    usage, size = Usage(), diagonal(arm.verb)
    usage.record(arm, some(arm, 3), np.array([0.01, 0.03, np.nan]) * size, rows=3)
    seen = counted(usage)["arm3"]
    assert (seen.error, seen.answers) == (pytest.approx(0.02), 2)
    usage.record(arm, some(arm, 1), np.array([0.08 * size]))
    seen = counted(usage, ERRORS_HALF_LIFE_S)["arm3"]
    assert (seen.error, seen.answers) == (pytest.approx(0.05), pytest.approx(2))


def test_errors_are_those_of_the_current_version(arm):
    newer = Entry.of_verb(arm.verb, path=arm.path, version=2)
    usage = Usage()
    usage.record(arm, some(arm, 5), np.full(5, 0.1), rows=5)
    counted(usage)
    usage.record(newer, some(arm, 1), np.array([0.2]))
    usage.record(arm, some(arm, 2), rows=2)  # by the earlier version, on usage: it counts as usage
    seen = counted(usage)["arm3"]
    assert (seen.version, seen.answers, total(seen)) == (2, 1, 8)


def test_other_examples_reset_the_counts(arm):
    moved = replace(arm.verb, values=arm.verb.values + 0.5)
    other = Entry(moved, arm.evaluator, 2, arm.path, b"", "", arm.span_s, arm.methods)
    usage = Usage()
    usage.record(arm, some(arm, 5), rows=5)
    counted(usage)
    usage.record(other, some(arm, 1))
    assert total(counted(usage)["arm3"]) == 1


def test_a_verb_without_requests_is_dropped(arm, catalog):
    usage = Usage()
    usage.record(arm, some(arm, 1))
    counted(usage)
    usage.record(catalog.entries["reach"], some(catalog.entries["reach"], 1))
    assert counted(usage, FORGET_S).keys() == {"reach"}


def _sample(usage, groups):
    sampler = CharacterSampler(usage)
    sampler.record(sampler.take(groups))


def test_characters_of_streams_are_recorded(arm):
    group, usage = Group(arm, "rbf"), Usage()
    slots = [group.characters.add(row) for row in some(arm, 20)]
    for slot in slots[:5]:
        group.characters.remove(slot)
    _sample(usage, [group, Group(arm, "rbf")])
    seen = counted(usage)["arm3"]
    assert (total(seen), seen.answers) == (15, 0)  # none has had a frame yet
    assert seen.to_json()["cells"] == cells_json(arm.verb, some(arm, 20)[5:])["cells"]


def test_errors_of_characters_count_inside_the_domain(arm):
    group, usage = Group(arm, "rbf"), Usage()
    inside = some(arm, 8)
    for row in (*inside, [50.0, 50.0]):
        group.characters.add(np.asarray(row))
    group.characters.step(group.characters.taken(), 0.02)
    _sample(usage, [group])
    seen = counted(usage)["arm3"]
    assert (total(seen), seen.answers) == (9, 8)
    off = arm.evaluator.blend(inside, method="rbf").error
    assert seen.error == pytest.approx(off.mean() / diagonal(arm.verb), rel=1e-6)


@pytest.mark.anyio
async def test_errors_of_requests_count_inside_the_domain(catalog):
    app = app_of(catalog)
    app.state.server.usage = usage = Usage()
    async with client_of(app) as client:
        for x in (0.4, 0.5, 50.0):
            answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": {"x": x, "y": 0.2}, "method": "rbf"})
            assert answer.json()["clamped"] == (x == 50.0)
    seen = counted(usage)["arm3"]
    assert (total(seen), seen.answers) == (3, 2)


def test_samples_of_a_crowd_cover_all_characters_in_turn(arm):
    usage, group = Usage(), Group(arm, "corrected")
    sampler = CharacterSampler(usage)
    for k in range(3 * MAX_SAMPLES):
        group.characters.add(np.array([0.3 + 1e-4 * k, 0.2]))
    seen = set()
    for _ in range(3):
        sampler.record(sampler.take([group]))
        ((_, rows, _),) = usage.take()
        assert len(rows) == MAX_SAMPLES
        seen |= set(rows[:, 0])
    assert len(seen) == 3 * MAX_SAMPLES


def test_old_cells_weigh_less():
    cell = {"adverbs": [0.1, 0.2], "weight": 8.0}
    rows = [{"cells": [cell], "at_s": 0.0}, {"cells": [cell], "at_s": HALF_LIFE_S}, {"cells": [cell]}, {}]
    assert [one["weight"] for one in merge_cells(rows, HALF_LIFE_S)] == [4.0, 8.0, 8.0]


def test_recording_a_request_is_cheap(arm):
    usage, requested, errors = Usage(limit=10**9), {"x": 0.4, "y": 0.3}, np.zeros(1)
    arm.evaluator.pose(requested)

    def took(work):
        started = time.perf_counter()
        for _ in range(2_000):
            work()
        return time.perf_counter() - started

    ratios = [
        took(lambda: usage.record(arm, requested, errors)) / took(lambda: arm.evaluator.pose(requested))
        for _ in range(5)
    ]
    assert min(ratios) < 0.1
