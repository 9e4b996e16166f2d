"""The model of streaming servers: its fit, its bandwidth against a real server, its ticks, its tables."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adverb_load.client import Load
from adverb_load.crowd import run_crowd

from benchmarks import scaling
from benchmarks import scaling_model as model
from benchmarks.scaling_model import COSTS, FPS, READER_COSTS, Group, Model, Plan, Shape
from service.catalog import catalog as catalogs
from tests.clients.python.served import serve

DOC = Path(__file__).parents[2] / "docs" / "scaling.md"
SHAPE = Shape(joints=23, examples=35, intervals=588)
COST_US = (3_000.0, 8.0, 0.6, 0.65, 0.62, 0.3, 0.4, 1.5, 5.0, 0.1)


def machine(**changed) -> Model:
    costs = {name: 1e-6 * cost for name, cost in zip(COSTS, COST_US, strict=True)}
    reader = dict(zip(READER_COSTS, (3e-6, 1e-10, 4e-6), strict=True))
    return Model(SHAPE, costs | {name: 1e-6 * cost for name, cost in changed.items()}, reader)


def test_the_fit_finds_the_costs_that_made_its_points():
    made = machine()
    rows = [model.rates(groups, SHAPE) for groups in scaling.SMALL]
    found = model.fit([(row, model.total(row, made.costs)) for row in rows])
    for name in COSTS:
        assert found[name] == pytest.approx(made.costs[name], rel=1e-6), name


def test_the_fit_reproduces_points_with_errors_and_has_no_negative_cost():
    made, rng = machine(), np.random.default_rng(2)
    rows = [model.rates(groups, SHAPE) for groups in scaling.SMALL]
    points = [(row, model.total(row, made.costs) * rng.uniform(0.97, 1.03)) for row in rows]
    found = model.fit(points)
    assert min(found.values()) >= 0.0
    for row, cpu in points:
        assert model.total(row, found) == pytest.approx(cpu, rel=0.06)


def test_the_small_loads_tell_all_costs_apart():
    rows = np.array([list(model.rates(groups, SHAPE).values()) for groups in scaling.SMALL])
    assert np.linalg.matrix_rank(rows / np.abs(rows).max(axis=0), tol=1e-4) == len(COSTS)


@pytest.mark.parametrize(("encoding", "channels"), [("f32", 1), ("q48", 7), ("q32", 4), ("weights", 3)])
def test_bandwidth_is_that_of_a_real_server(address, encoding, channels):
    group, shape = Group(2, channels, encoding, 20.0), Shape(28, 24, 1)
    load = Load(address.replace("http", "ws") + "/v1/stream", "reach", encoding, 2, channels, FPS, "corrected", 20.0,
                bulk=True, events=False)  # fmt: skip
    found = run_crowd(load, seconds=0.5, settle_s=0.2)
    assert (found.wrong, found.codes) == (0, {})
    assert found.messages > 0
    assert found.bytes == found.messages * shape.message_bytes(group)
    assert found.expected / found.load.sockets / channels == 0.5 * FPS


@pytest.fixture(scope="module")
def address():
    with serve(catalogs.load(None)) as found:
        yield found


@pytest.mark.parametrize("characters", [1, 60, 1_000, 8_000])
def test_blocks_are_those_of_random_phases(characters):
    drawn = np.random.default_rng(5).integers(588, size=(400, characters))
    counted = [np.ceil(np.bincount(row, minlength=588) / model.BLOCK).sum() for row in drawn]
    assert model.blocks(characters, 588) == pytest.approx(np.mean(counted), rel=0.01)


def test_weights_are_sent_without_sums():
    assert model.rates([Group(10, 10, "weights")], SHAPE)["block"] == 0.0


def test_bytes_on_the_wire_count_heads_of_all_layers():
    assert SHAPE.message_bytes(Group(1, 1)) == 20 + 404
    assert SHAPE.wire_bytes(Group(1, 1)) == 4 + 424 + 90
    whole = 4 + 20 + 100 * 404
    assert SHAPE.wire_bytes(Group(1, 100)) == whole + 90 * math.ceil(whole / 1_448)
    assert SHAPE.wire_bytes(Group(1, 200)) - SHAPE.message_bytes(Group(1, 200)) > 10


def test_a_light_load_is_on_time():
    groups = [Group(10, 10), Group(5, 20, "q48", 10.0)]
    found = model.simulate(groups, machine(), seconds=5.0)
    assert found.delivered == 1.0
    assert found.payload == FPS * sum(group.sockets * SHAPE.message_bytes(group) for group in groups)
    assert found.cpu == pytest.approx(model.total(model.rates(groups, SHAPE), machine().costs))
    for p50, p99 in found.late_ms:
        assert 0.0 < p50 < p99 < 1.0


def test_delays_of_the_machine_are_added():
    late = replace(machine(), delays_s=[(0.0, 0.002), (1.0, 0.002)])
    one, other = (model.simulate([Group(10, 10)], found, seconds=2.0) for found in (machine(), late))
    assert other.late_ms[0][0] == pytest.approx(one.late_ms[0][0] + 2.0, abs=1e-6)


@pytest.mark.parametrize("times", [1.5, 2.0, 4.0])
def test_an_overload_delivers_what_one_core_can(times):
    costs = dict.fromkeys(("process", "block", "frame", "row", "moving"), 0.0)
    loaded = machine(f32=times * 1e6 / FPS / 1_000, message=0.0, **costs)
    found = model.simulate([Group(10, 100)], loaded, seconds=30.0)
    assert found.delivered == pytest.approx(1.0 / times, rel=0.03)
    assert found.cpu == pytest.approx(1.0, rel=0.03)
    assert found.payload == pytest.approx(found.delivered * FPS * 10 * SHAPE.message_bytes(Group(1, 100)))
    assert found.late_ms[0][0] > 1e3 / FPS


def test_a_capacity_holds_and_a_tenth_more_does_not():
    plan = Plan()
    for encoding in ("f32", "weights"):
        characters, cpu = model.capacity(plan, encoding, machine())
        sockets = characters // plan.channels
        assert 0.5 < cpu <= 1.0
        at_once = replace(machine(), reader=dict.fromkeys(READER_COSTS, 0.0))
        assert model.holds(model.simulate(plan.groups(sockets, encoding), at_once, seconds=4.0))
        assert not model.holds(model.simulate(plan.groups(round(1.1 * sockets), encoding), at_once, seconds=4.0))


def test_a_slow_reader_does_not_lower_a_capacity():
    slow = replace(machine(), reader=dict.fromkeys(READER_COSTS, 1e-3))
    assert model.capacity(Plan(), "f32", slow) == model.capacity(Plan(), "f32", machine())


def test_time_that_others_take_lowers_what_is_delivered():
    groups = [Group(100, 100)]
    one, other = (model.simulate(groups, machine(), kept=kept, seconds=5.0) for kept in (0.0, 0.7))
    assert one.delivered == 1.0
    assert 0.3 < other.delivered < 0.9
    assert other.late_ms[0][0] > one.late_ms[0][0]


def test_sizes_are_consistent():
    plan, found = Plan(), machine()
    for characters in scaling.CHARACTERS:
        rows = {name: model.size(plan, name, characters, 8_000, 2.0, found) for name in scaling.ENCODINGS}
        rows["recipe"] = model.recipe(plan, characters, 2.0, found)
        for row in rows.values():
            assert row.cores_per_hour == pytest.approx(plan.core_hour * row.cores)
            assert row.traffic_per_hour == pytest.approx(3_600 * row.gbit_s / 8 * plan.gigabyte)
            assert row.memory_gb == pytest.approx(characters * 2_048e-9)
        assert (rows["f32"].cores - 1) * plan.headroom * 8_000 < characters <= rows["f32"].cores * plan.headroom * 8_000
        traffic = [rows[name].gbit_s for name in ("f32", "q48", "weights", "q32", "recipe")]
        assert traffic == sorted(traffic, reverse=True)


def test_a_budget_lowers_the_rate():
    record = SHAPE.record_bytes("q48")
    assert model.rate_of_budget(1e9, 100, record) == FPS
    half = model.rate_of_budget(5_000, 100, record)
    assert FPS * 30 + 100 * record * half == pytest.approx(5_000 * 125)
    assert model.rate_of_budget(1, 100, record) == 0.0


def test_budgets_of_the_documentation_are_those_of_the_model():
    lines = [line.split("|")[1:5] for line in DOC.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    rows = [row for row in lines if re.fullmatch(r" [\d,]+ ", row[0])]
    assert len(rows) == 4
    for kbps, *cells in rows:
        for encoding, cell in zip(("f32", "q48", "q32"), cells, strict=True):
            rate = model.rate_of_budget(float(kbps.replace(",", "")), 100, SHAPE.record_bytes(encoding))
            assert float(cell) == pytest.approx(rate, abs=0.051)


def test_the_documentation_has_each_assumption_that_the_model_names():
    text = DOC.read_text(encoding="utf-8")
    named = set(re.findall(r"\bA\d+\b", Path(model.__file__).read_text(encoding="utf-8")))
    assert named
    assert named <= set(re.findall(r"^\| (A\d+) \|", text, re.MULTILINE))
    assert scaling.FIRST in text
    assert scaling.LAST in text


def test_tables_replace_what_stands_between_the_marks(tmp_path):
    path = tmp_path / "scaling.md"
    path.write_text(f"head\n{scaling.FIRST}\nold\n{scaling.LAST}\ntail\n", encoding="utf-8")
    scaling.write(path, "new\n")
    assert path.read_text(encoding="utf-8") == f"head\n{scaling.FIRST}\nnew\n{scaling.LAST}\ntail\n"
    path.write_text("no marks", encoding="utf-8")
    with pytest.raises(ValueError, match="no marks"):
        scaling.write(path, "new\n")


def test_the_sizing_table_has_all_encodings_and_sizes():
    lines = list(scaling.sizing(machine(), 2.0, Plan()))
    for characters in scaling.CHARACTERS:
        names = [line.split("|")[1].strip() for line in lines if line.startswith(f"| {characters:,}, `")]
        assert names == [f"{characters:,}, `{name}`" for name in scaling.ENCODINGS] + [
            f"{characters:,}, `recipe` (estimate)"
        ]
    columns = {line.count("|") for line in lines if "`recipe`" in line}
    assert columns == {8}


def test_the_checked_sizes_have_the_number_of_characters_they_name():
    for characters, groups in scaling.SIZES.items():
        assert sum(group.characters for group in groups) == characters
        assert groups not in scaling.SMALL
        assert len(groups) > 1
    assert all(len(groups) == 1 for groups in scaling.SMALL)
    largest = max(group.characters for groups in scaling.SMALL for group in groups)
    assert largest <= max(scaling.SIZES) / 2
