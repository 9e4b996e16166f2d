"""`make chaos`: its schedule, each of its checks on a record that is wrong, and a short run of the whole."""

import asyncio
import dataclasses
import random
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.chaos import report, verdict
from benchmarks.chaos.cluster import CannotRun, cluster
from benchmarks.chaos.ledger import Answer, Changes, Happened, Ledger, Outage, Refined, Sample, Stall
from benchmarks.chaos.plan import FAULTS, LAST_FAULT_S, OWN, Fault, Plan
from benchmarks.chaos.requests import Requester
from benchmarks.chaos.run import run
from benchmarks.chaos.streams import Watched
from benchmarks.chaos.verdict import Found
from service.store.records import Event

SECONDS = 600.0
FOUND = Found(
    versions={("chaos-0", 1): "a", ("chaos-0", 2): "b"},
    current={"chaos-0": 2},
    refined={},
    disorder=(),
    unreadable=(),
    listed={"connection 0": {"chaos-0": 2}},
    jobs={"job": "published"},
)
KILLED = Happened(Fault(100.0, "kill server"), 100.0, 100.0, (7,))
DOWN = Happened(Fault(200.0, "stop database", 0, 5.0), 200.0, 205.0)
WORKER = Happened(Fault(300.0, "kill worker"), 300.0, 300.0, (8,))


@pytest.fixture
def ledger() -> Ledger:
    """The record of a run in which everything holds."""
    made = Ledger(faults=[KILLED, DOWN, WORKER], messages=10, jobs={"job": "chaos-0"})
    made.versions = {("chaos-0", 1): "a", ("chaos-0", 2): "b"}
    made.of("chaos-0").acknowledged(49.0, 50.0, 2)
    made.compare("REST JSON, measured", 2e-7)
    made.answers = [
        Answer(100.0, 101.0, "pose", "ReadError"),
        Answer(212.0, 212.1, "versions", "503 store_unavailable"),
    ]
    for at_s in range(0, 600, 5):
        made.samples += [Sample(float(at_s), 20.0, kind, 1, 300.0, 30.0, 40) for kind in ("parent", "server", "worker")]
    return made


def wrong(check) -> str:
    assert check.wrong, check.fact
    return " ".join(check.wrong)


# ── the schedule ─────────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_same_seed_gives_the_same_schedule():
    plan = Plan.of(7, SECONDS, 50)
    assert Plan.of(7, SECONDS, 50) == plan
    assert Plan.of(8, SECONDS, 50).faults != plan.faults
    assert Plan.of(7, SECONDS, 60).faults == plan.faults


def test_a_schedule_is_bounded_and_has_every_kind_of_fault():
    plan = Plan.of(1, SECONDS, 200)
    assert {row.kind for row in plan.faults} == set(FAULTS)
    assert all(row.at_s + row.seconds <= SECONDS - LAST_FAULT_S + 0.1 for row in plan.faults)
    ends = [row.at_s + row.seconds for row in plan.faults]
    assert all(after.at_s > end_s for end_s, after in zip(ends, plan.faults[1:], strict=False))
    assert all(row.at_s < SECONDS for row in plan.operations)
    assert {row.verb for row in plan.operations if row.kind == "delete"} <= set(OWN)
    assert len(plan.streams) == 200


# ── the checks ───────────────────────────────────────────────────────────────────────────────────────────────────────


def test_everything_holds_for_a_good_record(ledger):
    checks = [
        verdict.check_versions(ledger, FOUND),
        verdict.check_jobs(ledger, FOUND, {"published"}, ()),
        verdict.check_measured(ledger),
        verdict.check_numbers(ledger),
        verdict.check_streams(ledger, 3, 3),
        verdict.check_answers(ledger),
        verdict.check_memory(ledger, SECONDS),
        verdict.check_log(ledger, ['{"event": "server died; starting another", "code": -9}', "worker is ready"]),
        verdict.check_files({"server": ["socket:"]}, {"server": ["socket:", "artifacts"]}, [], verbs=1),
    ]
    assert not [check for check in checks if check.wrong]
    assert not any("FAILS" in line for line in report.lines(checks))


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"versions": {("chaos-0", 2): "b"}}, "it is lost"),
        ({"versions": {("chaos-0", 1): "c", ("chaos-0", 2): "b"}}, "another hash"),
        ({"unreadable": ("chaos-0 1: no poses",)}, "no poses"),
        ({"current": {"chaos-0": 1}, "listed": {"connection 0": {"chaos-0": 1}}}, "1 is current"),
        ({"current": {}, "listed": {"connection 0": {}}}, "None is current"),
        ({"listed": {"connection 0": {"chaos-0": 1}}}, "connection 0 serves"),
        ({"disorder": ("chaos-0: 1 was current",)}, "1 was current"),
    ],
)
def test_versions_fail(ledger, changed, problem):
    assert problem in wrong(verdict.check_versions(ledger, replace(FOUND, **changed)))


def test_a_change_without_an_answer_may_have_happened():
    changes = Changes()
    changes.acknowledged(9.0, 10.0, 1)
    assert changes.allows(1, set(), {})
    assert not changes.allows(None, set(), {})
    changes.unsure += [(11.0, None, False), (11.0, None, True)]
    assert changes.allows(None, set(), {})
    assert changes.allows(3, {3}, {})
    assert not changes.allows(3, set(), {})
    changes.acknowledged(99.0, 100.0, 2)
    assert not changes.allows(None, set(), {})


CHAIN = {"versions": {("chaos-0", k): name for k, name in enumerate("abcd", 1)}}


@pytest.mark.parametrize(
    ("possible", "refined", "current", "allowed"),
    [
        (1, {3: Refined(1, 60.0)}, 3, True),
        (1, {3: Refined(1, 60.0), 4: Refined(3, 70.0)}, 4, True),
        (1, {3: Refined(1, 40.0)}, 3, False),  # a roll-back to 1 was acknowledged after it
        (1, {3: Refined(1, 40.0), 4: Refined(3, 70.0)}, 4, False),
        (1, {3: Refined(2, 60.0)}, 3, False),  # 2 was not current
        (1, {3: Refined(1, float("-inf"))}, 3, False),
        (None, {3: Refined(2, 40.0)}, 3, False),  # deleted after it
        (None, {3: Refined(2, 60.0)}, 3, False),
    ],
)
def test_a_refined_version_is_current_only_after_the_last_change_and_of_what_was_current(
    ledger, possible, refined, current, allowed
):
    ledger.of("chaos-0").acknowledged(49.0, 50.0, possible)
    rows = {("chaos-0", number): row for number, row in refined.items()}
    found = replace(FOUND, **CHAIN, refined=rows, current={"chaos-0": current})
    found = replace(found, listed={"connection 0": {"chaos-0": current}})
    check = verdict.check_versions(ledger, found)
    assert not check.wrong if allowed else f"{current} is current" in wrong(check)


def test_an_unanswered_upload_does_not_excuse_a_refined_version(ledger):
    changes = ledger.of("chaos-0")
    changes.acknowledged(49.0, 50.0, 1)
    changes.unsure.append((51.0, None, True))
    found = replace(FOUND, **CHAIN, refined={("chaos-0", 3): Refined(2, 40.0)}, current={"chaos-0": 3})
    assert "3 is current" in wrong(verdict.check_versions(ledger, found))


def history(*rows):
    """Events of kind, version, and what is current then."""
    return [Event("v", kind, number, current, "ada", "", float(at)) for at, (kind, number, current) in enumerate(rows)]


def test_a_history_has_refinements_only_of_what_was_current():
    good = history(("publish", 1, 1), ("refine", 1, 1), ("publish", 2, 2), ("activate", 1, 1), ("publish", 3, 1))
    assert verdict.history_problems("v", good, {2: 1, 3: 2}, 1) == []
    (problem,) = verdict.history_problems("v", good, {2: 1, 3: 2}, 3)
    assert "ends with 1" in problem
    undone = history(("publish", 1, 1), ("publish", 2, 2), ("activate", 1, 1), ("activate", 3, 3))
    (problem,) = verdict.history_problems("v", undone, {3: 2}, 3)
    assert problem == "v: 1 was current when 3 replaced it, which refines 2"
    deleted = history(("publish", 1, 1), ("delete", 1, None), ("publish", 2, 2))
    assert "None was current" in " ".join(verdict.history_problems("v", deleted, {2: 1}, 2))


def test_refinements_fail_that_are_lost_or_stuck(ledger):
    assert "lost" in wrong(verdict.check_jobs(ledger, replace(FOUND, jobs={}), {"published"}, ()))
    running = replace(FOUND, jobs={"job": "running"})
    assert "no progress" in wrong(verdict.check_jobs(ledger, running, {"published"}, ()))
    assert not verdict.check_jobs(ledger, running, {"published"}, {"job"}).wrong


@pytest.mark.parametrize("difference_m", [2e-6, float("nan")])
def test_measured_values_fail_beyond_the_tolerance(ledger, difference_m):
    ledger.compare("REST JSON, measured", difference_m)
    assert "REST JSON" in wrong(verdict.check_measured(ledger))
    assert "no pose" in wrong(verdict.check_measured(Ledger()))


VERB = {
    "measure": {"kind": "joint_position", "adverbs": ["x", "y", "z"], "effector": "hand", "keytime": "apex"},
    "skeleton": {"parents": [-1, 0], "names": ["hips", "hand"], "offsets": [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]},
    "keytime_names": ["apex"],
    "keytime_phases": [0.5],
}


class Motion(SimpleNamespace):
    """A sequence of two frames, in which the hand is one metre above the hips."""

    def __len__(self):
        return 2


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({}, ""),
        ({"errors": np.array([0.1, 0.1])}, "REST sequence, error"),
        (
            {"positions": np.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 1.1, 0.0]]])},
            "positions",
        ),
        ({"measured": None}, "no measured value"),
    ],
)
def test_sequences_are_measured_again(ledger, changed, problem):
    identity = np.tile(np.float32([0, 0, 0, 1]), (2, 2, 1))
    found = {
        "root": np.zeros((2, 3), np.float32),
        "rotations": identity,
        "positions": np.tile(np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), (2, 1, 1)),
        "measured": {"x": 0.0, "y": 1.0, "z": 0.0},
        "errors": np.array([0.5, 0.5]),
        "clamped": False,
    }

    async def sequence(*_, **__):
        return Motion(**found | changed)

    goals = {"v": SimpleNamespace(adverbs=lambda _: {"x": 0.0, "y": 1.5, "z": 0.0})}
    requester = Requester("", {"v": VERB}, goals, random.Random(1), ledger)
    asyncio.run(requester.sequence(SimpleNamespace(sequence=sequence), "v"))
    assert (problem in " ".join(ledger.wrong)) if problem else not ledger.wrong
    assert problem or ledger.compared["REST sequence, positions"] == 2


def test_gaps_and_silence_fail(ledger):
    assert "no pose message" in wrong(verdict.check_numbers(Ledger()))
    ledger.gaps = 2
    assert "2 messages" in wrong(verdict.check_numbers(ledger))


def test_streams_fail_that_stall_or_have_no_frames(ledger):
    assert "1 of 3" in wrong(verdict.check_streams(ledger, 3, 2))
    ledger.stalls.append(Stall(2, 150.0, ("session s",)))
    assert "session s" in wrong(verdict.check_streams(ledger, 3, 3))


def test_recovery_is_counted_from_the_fault_before_the_loss():
    outages = [Outage(0, 100.1, 101.0, False), Outage(1, 100.2, 103.0, False), Outage(0, 300.5, 301.0, True)]
    found = verdict.recoveries([DOWN, KILLED, WORKER], outages)
    assert [(row.fault.kind, seconds) for row, seconds in found] == [
        ("kill server", [1.0, 3.0]),
        ("stop database", []),
        ("kill worker", [1.0]),
    ]


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (Answer(150.0, 150.1, "pose", "ReadError"), "outside of any fault"),
        (Answer(301.0, 301.1, "pose", "503 not_ready"), "outside of any fault"),
        (Answer(100.0, 100.1, "pose", "500 internal_error"), "not an expected problem"),
        (Answer(201.0, 246.0, "pose", "ReadTimeout"), "not an expected problem"),
    ],
)
def test_requests_fail_without_a_fault_or_in_an_unexpected_way(ledger, answer, problem):
    ledger.answers.append(answer)
    assert problem in wrong(verdict.check_answers(ledger))


def test_time_without_a_server_excuses_failures_until_shortly_after(ledger):
    for at_s in (398.0, 400.0):
        ledger.serves(at_s, running=True)
    for at_s in (402.0, 404.0):
        ledger.serves(at_s, running=False)
    ledger.serves(406.0, running=True)
    ledger.serves(408.0, running=False)
    assert ledger.down == [(400.0, 404.0), (406.0, 408.0)]
    ledger.answers.append(Answer(413.0, 413.1, "pose", "503 not_ready"))
    assert not verdict.check_answers(ledger).wrong
    ledger.answers.append(Answer(420.0, 420.1, "pose", "503 not_ready"))
    assert "420.0" in wrong(verdict.check_answers(ledger))


def test_anything_else_that_was_wrong_fails_the_answers(ledger):
    ledger.fault("a verb is listed after its deletion")
    assert "listed after" in wrong(verdict.check_answers(ledger))


@pytest.mark.parametrize("kind", ["parent", "server", "worker"])
def test_memory_fails_that_grows(ledger, kind):
    late = [replace(row, rss_mib=340.0) if row.kind == kind and row.at_s > 400 else row for row in ledger.samples]
    ledger.samples = late
    assert f"{kind} grew" in wrong(verdict.check_memory(ledger, SECONDS))


def test_memory_compares_processes_of_similar_age(ledger):
    young = [replace(row, rss_mib=500.0, uptime_s=1.0) for row in ledger.samples if row.kind == "server"]
    ledger.samples += young
    assert not verdict.check_memory(ledger, SECONDS).wrong
    assert "no process" in wrong(verdict.check_memory(Ledger(), 60.0))


@pytest.mark.parametrize("kind", ["parent", "server", "worker"])
def test_memory_fails_without_samples_of_a_kind_in_a_long_run(ledger, kind):
    ledger.samples = [row for row in ledger.samples if row.kind != kind]
    assert f"{kind} was not sampled" in wrong(verdict.check_memory(ledger, SECONDS))


class Held(Watched):
    """A held stream without a connection."""

    def __init__(self, ledger):
        self.ledger, self.number, self.plan = ledger, 3, Plan.of(1, SECONDS, 1).streams[0]
        self.plan = replace(self.plan, encoding="f32")
        self._goal, self._doubted = {1: (10.0, [0.0])}, {}

    def _story(self):
        return ""


def test_a_single_frame_beyond_the_tolerance_is_counted_and_a_second_one_fails(ledger):
    held, record = Held(ledger), SimpleNamespace(version=1)
    for difference_m in (1.0, 1e-7):
        held._compare(1, difference_m, record)
    check = verdict.check_measured(ledger)
    assert not check.wrong
    assert "single frames beyond that: stream f32 1" in check.fact
    held._compare(1, 1.0, record)
    assert "stream f32" in wrong(verdict.check_measured(ledger))


def test_files_fail_that_stay():
    idle = {"server": ["socket:"] * 3}
    assert "socket" in wrong(verdict.check_files(idle, {"server": ["socket:"] * 20}, [], verbs=0))
    assert "artifacts" in wrong(verdict.check_files(idle, {"server": ["socket:"] * 3 + ["artifacts"] * 4}, [], verbs=2))
    assert "left over: tmp/x" in wrong(verdict.check_files(idle, idle, ["tmp/x"], verbs=0))


@pytest.mark.parametrize(
    "line",
    [
        '{"event": "server died; starting another", "code": -11}',
        '{"event": "request failed", "level": "error"}',
        "Traceback (most recent call last):",
    ],
)
def test_the_log_fails(ledger, line):
    assert verdict.check_log(ledger, [line]).wrong


def test_the_log_fails_where_a_process_ends_without_a_fault(ledger):
    line = '{"event": "server died; starting another", "code": 0}'
    assert not verdict.check_log(ledger, [line]).wrong
    assert "2 times" in wrong(verdict.check_log(ledger, [line, line]))


def test_tables_replace_those_before(ledger, tmp_path):
    path = tmp_path / "chaos.md"
    path.write_text(f"before\n{report.START}\nformer table\n{report.END}\nafter\n")
    text = report.markdown(Plan.of(1, SECONDS, 3), ledger, [verdict.check_numbers(ledger)], "make chaos")
    report.write(path, text)
    content = path.read_text()
    assert "former table" not in content
    assert content.startswith("before\n")
    assert content.endswith("after\n")
    assert "| kill server | 1 |" in content
    assert "| sequence numbers | holds |" in content


# ── the whole ────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_a_short_run_recovers(tmp_path):
    plan = Plan.of(1, 20.0, 6)
    faults = (Fault(5.0, "kill all servers"), Fault(11.0, "stop database", 0, 2.0))
    plan = dataclasses.replace(plan, faults=faults)
    try:
        with cluster() as running:
            process, folder = running.process, running.folder
            ledger, checks = run(plan, running)
    except CannotRun as err:
        pytest.skip(str(err))
    # A run of 20 s may end before replaced versions are collected, and before any process is old enough to compare.
    early = ("no process was sampled", "has more open files than idle")
    assert not [line for line in report.lines(checks) if "wrong" in line and not any(text in line for text in early)]
    assert len(ledger.faults[0].pids) == 2
    assert ledger.outages
    assert process.poll() is not None
    assert not Path(folder).exists()
