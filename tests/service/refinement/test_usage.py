"""What is asked of verbs is counted: where, how often, how far off; bounded, fading, and for next to nothing."""

import time
from dataclasses import replace

import numpy as np
import pytest

from service.catalog.catalog import Entry
from service.refinement.usage import ERRORS_HALF_LIFE_S, FORGET_S, Demand
from service.refinement.usage_counts import CELLS, HALF_LIFE_S, cells_of, together
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


def counted(demand, now_s=0.0):
    demand.count(demand.take(), now_s)
    return demand.observed


def total(observed):
    return observed.cells[1].sum()


def test_however_adverbs_are_given_they_are_counted_alike(arm):
    rows = some(arm, 300)
    named = [dict(zip(NAMES, row, strict=True)) for row in rows.tolist()]
    told = []
    for asks in ([(rows, 300)], [(named, 300)], [(one, 1) for one in named]):
        demand = Demand()
        for adverbs, count in asks:
            demand.ask(arm, adverbs, rows=count)
        told.append(counted(demand)["arm3"].told())
    assert told[0] == told[1] == told[2] == {**cells_of(arm.verb, rows), "at_s": 0.0}


def test_counts_add_up_and_fade(arm):
    demand = Demand()
    demand.ask(arm, some(arm, 40), rows=40)
    counted(demand)
    demand.ask(arm, some(arm, 10, seed=1), rows=10)
    assert total(counted(demand, HALF_LIFE_S)["arm3"]) == pytest.approx(30)
    demand.ask(arm, some(arm, 1), rows=1)
    assert total(counted(demand, HALF_LIFE_S)["arm3"]) == pytest.approx(31)


def test_a_rush_is_counted_up_to_a_bound_and_what_is_kept_of_it_is_bounded(arm):
    demand = Demand(most=100)
    for k in range(50):
        demand.ask(arm, some(arm, 60, seed=k), rows=60)
    assert total(counted(demand)["arm3"]) == 120
    for k in range(10):
        demand.ask(arm, some(arm, 3_000, seed=k), rows=3_000)
        counted(demand)
    assert len(demand.observed["arm3"].cells[1]) <= CELLS**2
    silent = Demand(most=0)
    silent.ask(arm, some(arm, 1))
    assert silent.take() == []


def test_adverbs_outside_are_counted_where_they_were_drawn_back_to(arm):
    demand, outside = Demand(), np.array([[1e6, -1e6]])
    demand.ask(arm, outside)
    inside, moved = arm.evaluator.clamp(outside)
    assert moved.all()
    (cell,) = counted(demand)["arm3"].told()["cells"]
    assert cell == cells_of(arm.verb, inside)["cells"][0]


def test_errors_are_shares_of_the_diagonal_and_fade(arm):
    demand, size = Demand(), diagonal(arm.verb)
    demand.ask(arm, some(arm, 3), np.array([0.01, 0.03, np.nan]) * size, rows=3)
    seen = counted(demand)["arm3"]
    assert (seen.error, seen.answers) == (pytest.approx(0.02), 2)
    demand.ask(arm, some(arm, 1), np.array([0.08 * size]))
    seen = counted(demand, ERRORS_HALF_LIFE_S)["arm3"]
    assert (seen.error, seen.answers) == (pytest.approx(0.05), pytest.approx(2))


def test_errors_are_those_of_the_version_that_answers_now(arm):
    newer = Entry.of_verb(arm.verb, path=arm.path, version=2)
    demand = Demand()
    demand.ask(arm, some(arm, 5), np.full(5, 0.1), rows=5)
    counted(demand)
    demand.ask(newer, some(arm, 1), np.array([0.2]))
    demand.ask(arm, some(arm, 2), rows=2)  # by the earlier version, on demand: it counts as asked
    seen = counted(demand)["arm3"]
    assert (seen.version, seen.answers, total(seen)) == (2, 1, 8)


def test_other_examples_start_anew(arm):
    moved = replace(arm.verb, values=arm.verb.values + 0.5)
    other = Entry(moved, arm.evaluator, 2, arm.path, b"", "", arm.span_s, arm.methods)
    demand = Demand()
    demand.ask(arm, some(arm, 5), rows=5)
    counted(demand)
    demand.ask(other, some(arm, 1))
    assert total(counted(demand)["arm3"]) == 1


def test_a_verb_that_nobody_asks_for_is_forgotten(arm, catalog):
    demand = Demand()
    demand.ask(arm, some(arm, 1))
    counted(demand)
    demand.ask(catalog.entries["reach"], some(catalog.entries["reach"], 1))
    assert counted(demand, FORGET_S).keys() == {"reach"}


def test_characters_of_streams_are_looked_at(arm):
    group, demand = Group(arm, "rbf"), Demand()
    slots = [group.characters.add(row) for row in some(arm, 20)]
    for slot in slots[:5]:
        group.characters.remove(slot)
    CharacterSampler(demand).sample([group, Group(arm, "rbf")])
    seen = counted(demand)["arm3"]
    assert (total(seen), seen.answers) == (15, 0)  # nobody has seen any of them yet
    assert seen.told()["cells"] == cells_of(arm.verb, some(arm, 20)[5:])["cells"]


def test_how_far_off_characters_are_counts_but_for_those_asked_outside(arm):
    group, demand = Group(arm, "rbf"), Demand()
    inside = some(arm, 8)
    for row in (*inside, [50.0, 50.0]):
        group.characters.add(np.asarray(row))
    group.characters.step(group.characters.taken(), 0.02)
    CharacterSampler(demand).sample([group])
    seen = counted(demand)["arm3"]
    assert (total(seen), seen.answers) == (9, 8)
    off = arm.evaluator.blend(inside, method="rbf").error
    assert seen.error == pytest.approx(off.mean() / diagonal(arm.verb), rel=1e-6)


@pytest.mark.anyio
async def test_of_requests_those_inside_the_domain_have_errors_that_count(catalog):
    app = app_of(catalog)
    app.state.serving.demand = demand = Demand()
    async with client_of(app) as client:
        for x in (0.4, 0.5, 50.0):
            answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": {"x": x, "y": 0.2}, "method": "rbf"})
            assert answer.json()["clamped"] == (x == 50.0)
    seen = counted(demand)["arm3"]
    assert (total(seen), seen.answers) == (3, 2)


def test_of_a_crowd_some_are_noted_at_a_time_and_all_in_turn(arm):
    demand, group = Demand(), Group(arm, "corrected")
    sampler = CharacterSampler(demand)
    for k in range(3 * MAX_SAMPLES):
        group.characters.add(np.array([0.3 + 1e-4 * k, 0.2]))
    seen = set()
    for _ in range(3):
        sampler.sample([group])
        ((_, rows, _),) = demand.take()
        assert len(rows) == MAX_SAMPLES
        seen |= set(rows[:, 0])
    assert len(seen) == 3 * MAX_SAMPLES


def test_what_a_server_said_long_ago_weighs_less():
    cell = {"adverbs": [0.1, 0.2], "weight": 8.0}
    rows = [{"cells": [cell], "at_s": 0.0}, {"cells": [cell], "at_s": HALF_LIFE_S}, {"cells": [cell]}, {}]
    assert [one["weight"] for one in together(rows, HALF_LIFE_S)] == [4.0, 8.0, 8.0]


def test_noting_a_request_costs_next_to_nothing(arm):
    demand, asked, errors = Demand(most=10**9), {"x": 0.4, "y": 0.3}, np.zeros(1)
    arm.evaluator.pose(asked)

    def took(work):
        started = time.perf_counter()
        for _ in range(2_000):
            work()
        return time.perf_counter() - started

    ratios = [took(lambda: demand.ask(arm, asked, errors)) / took(lambda: arm.evaluator.pose(asked)) for _ in range(5)]
    assert min(ratios) < 0.1
