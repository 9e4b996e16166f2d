"""The checks at the end: each takes what was recorded and returns one row of the table with what is wrong."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import median

from benchmarks.chaos.ledger import Answer, Happened, Ledger, Outage, Refined, Sample
from benchmarks.chaos.plan import DATABASE, SERVERS, WORKERS
from benchmarks.chaos.requests import TOLERANCE_M
from benchmarks.chaos.streams import TOLERANCES_M
from service.store.records import Event

__all__ = [
    "MORE_FILES", "Check", "Found", "check_answers", "check_files", "check_jobs", "check_log", "check_measured",
    "check_memory", "check_numbers", "check_streams", "check_versions", "history_problems", "recoveries",
]  # fmt: skip

WINDOW_S = {"server": 10.0, "database": 15.0}
"""Time after the end of a fault in which requests may fail, seconds; a fault of a worker allows no failure."""

TRANSPORT = {"ConnectError", "ReadError", "WriteError", "RemoteProtocolError", "ConnectTimeout"}
UNAVAILABLE = {"503 not_ready", "503 overloaded", "503 store_unavailable"}
"""Problems that are expected while servers or the database are away."""

FLAT = 1.1
"""Largest ratio of memory late in the run to memory early in it."""
AGE_S = (8.0, 120.0)
"""Ages between which processes are compared, seconds: loaded, and alike whichever fault ends them."""
EARLY, LATE = (0.2, 0.5), (0.7, 1.0)
"""Shares of the run."""
LEAST_SAMPLES = 3
LONG_S = 300.0
"""Length of a run from which every kind of process has enough samples, seconds."""
MORE_FILES = 8
"""Allowed number of open files beyond those of an idle process and one for each new verb, without files of metrics:
connections to the database are opened on demand."""
EXPECTED_CODES = (-9, 0)
"""Exit codes of processes that are killed and stopped."""
EXPECTED_ERROR = re.compile(r"^Error executing workflow .*OperationalError")
"""The queue reports a refinement that it drops while the database is away; its worker queues it again."""
SHOWN = 8


@dataclass(frozen=True, slots=True)
class Check:
    """A row of the table: what is checked, what was found, and what is wrong."""

    name: str
    fact: str
    wrong: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, fact: str, wrong: Iterable[str]) -> Check:
        """A row; of many problems the first are kept."""
        rows = list(wrong)
        more = [f"and {len(rows) - SHOWN} more"] if len(rows) > SHOWN else []
        return cls(name, fact, (*rows[:SHOWN], *more))


@dataclass(frozen=True, slots=True)
class Found:
    """What the store and the servers have after the run.

    Parameters
    ----------
    versions : mapping of (str, int) to str
        SHA-256 of every version.
    current : mapping of str to int
    refined : mapping of (str, int) to Refined
        Versions that refinements published.
    disorder : tuple of str
        What :func:`history_problems` found.
    unreadable : list of str
        Artifacts that cannot be loaded, or whose poses are not finite.
    listed : mapping of str to mapping
        Versions that each server lists, by the process.
    jobs : mapping of str to str
        State of each refinement.
    """

    versions: Mapping[tuple[str, int], str]
    current: Mapping[str, int]
    refined: Mapping[tuple[str, int], Refined]
    disorder: tuple[str, ...]
    unreadable: tuple[str, ...]
    listed: Mapping[str, Mapping[str, int]]
    jobs: Mapping[str, str]


def check_versions(ledger: Ledger, found: Found) -> Check:
    """Nothing acknowledged is lost, everything is readable, and all servers serve what is current."""
    wrong = [*found.unreadable, *found.disorder]
    for (verb, number), sha256 in ledger.versions.items():
        have = found.versions.get((verb, number))
        if have != sha256:
            wrong.append(
                f"{verb} {number} was acknowledged; " + ("it is lost" if have is None else "it has another hash")
            )
    for verb, changes in ledger.changes.items():
        current = found.current.get(verb)
        refined = {number: row for (name, number), row in found.refined.items() if name == verb}
        own = {number for name, number in found.versions if name == verb and number not in refined}
        unacknowledged = {number for number in own if (verb, number) not in ledger.versions}
        if not changes.allows(current, unacknowledged, refined):
            wrong.append(f"{verb}: {current} is current; acknowledged was {changes.possible}")
    wrong += [
        f"{server} serves {dict(listed)}, current is {dict(found.current)}"
        for server, listed in found.listed.items()
        if dict(listed) != dict(found.current)
    ]
    fact = f"{len(ledger.versions)} acknowledged, {len(found.versions)} in the store, all read: hash, artifact, poses"
    return Check.of("versions", fact, wrong)


def history_problems(verb: str, events: Iterable[Event], parents: Mapping[int, int], current: int | None) -> list[str]:
    """What the history of a verb has that may not be.

    Parameters
    ----------
    verb : str
    events : iterable of Event
        Oldest first.
    parents : mapping of int to int
        Of versions that refinements published, the versions that they refined.
    current : int or None
        The current version.
    """
    wrong, before = [], None
    for event in events:
        if event.kind not in ("publish", "activate", "delete"):
            continue
        parent = parents.get(event.number)
        if parent is not None and event.current == event.number and before not in (parent, event.number):
            wrong.append(f"{verb}: {before} was current when {event.number} replaced it, which refines {parent}")
        before = event.current
    if before != current:
        wrong.append(f"{verb}: {current} is current; its history ends with {before}")
    return wrong


def check_jobs(ledger: Ledger, found: Found, ended: Iterable[str], moving: Iterable[str]) -> Check:
    """Every accepted refinement exists, and has ended or makes progress.

    Parameters
    ----------
    ledger : Ledger
    found : Found
    ended : iterable of str
        Final states.
    moving : iterable of str
        Refinements whose progress changed in the recovery time.
    """
    final, going = set(ended), set(moving)
    wrong = [f"refinement {id} was accepted and is lost" for id in ledger.jobs.keys() - found.jobs.keys()]
    open_ = {id: state for id, state in found.jobs.items() if state not in final}
    wrong += [f"refinement {id} is {state} and makes no progress" for id, state in open_.items() if id not in going]
    states = Counter(found.jobs.values())
    fact = f"{len(ledger.jobs)} accepted; " + ", ".join(f"{state} {count}" for state, count in sorted(states.items()))
    return Check.of("refinements", fact, wrong)


def check_measured(ledger: Ledger) -> Check:
    """Measured values and errors are those that the client computes, within the tolerance of the encoding."""
    limits = {f"stream {name}": limit_m for name, limit_m in TOLERANCES_M.items()}
    wrong = [
        f"{kind}: {worst_m:.3g} m; {limits.get(kind, TOLERANCE_M):g} m are allowed"
        for kind, worst_m in ledger.worst.items()
        if not worst_m <= limits.get(kind, TOLERANCE_M)
    ]
    if not any(ledger.compared.values()):
        wrong.append("no pose was compared")
    fact = "; ".join(
        f"{kind}: {ledger.compared[kind]}, worst {worst_m:.1e} m (≤ {limits.get(kind, TOLERANCE_M):g})"
        for kind, worst_m in sorted(ledger.worst.items())
    )
    if ledger.doubted:
        rows = ", ".join(f"{kind} {count}" for kind, count in sorted(ledger.doubted.items()))
        fact += f"; single frames beyond that: {rows}"
    return Check.of("measured values", fact, wrong)


def check_numbers(ledger: Ledger) -> Check:
    """Sequence numbers have no gap that the count of dropped messages does not have."""
    wrong = [f"{ledger.gaps} messages are missing and not counted"] if ledger.gaps else []
    if not ledger.messages:
        wrong.append("no pose message arrived")
    fact = f"{ledger.messages} messages, {ledger.dropped} reported as dropped, {ledger.gaps} missing and not counted"
    return Check.of("sequence numbers", fact, wrong)


def recoveries(faults: Iterable[Happened], outages: Iterable[Outage]) -> list[tuple[Happened, list[float]]]:
    """Seconds from each fault to the next frame of each stream that lost its connection before the next fault."""
    rows = sorted(faults, key=lambda row: row.began_s)
    lost = sorted(outages, key=lambda row: row.began_s)
    found = []
    for fault, after in zip(rows, [*rows[1:], None], strict=True):
        end_s = float("inf") if after is None else after.began_s
        found.append((fault, [row.ended_s - fault.began_s for row in lost if fault.began_s <= row.began_s < end_s]))
    return found


def check_streams(ledger: Ledger, streams: int, alive: int) -> Check:
    """All streams have frames at the end, and none was without frames for long."""
    wrong = [f"stream {row.stream} had no frame at {row.at_s:.1f} s: {'; '.join(row.details)}" for row in ledger.stalls]
    if alive < streams:
        wrong.append(f"{streams - alive} of {streams} streams have no frames at the end")
    each = [seconds for _, rows in recoveries(ledger.faults, ledger.outages) for seconds in rows]
    last = [max(rows) for _, rows in recoveries(ledger.faults, ledger.outages) if rows]
    resumed = sum(row.resumed for row in ledger.outages)
    fact = f"{alive} of {streams} have frames at the end; {len(ledger.outages)} outages, {resumed} resumed"
    if ledger.down:
        fact += f"; no server ran {len(ledger.down)} times, at most for {max(b - a for a, b in ledger.down):.0f} s"
    if each:
        fact += (
            f"; fault to frame of a stream p50 {median(each):.2f} s, max {max(each):.2f} s; "
            f"to the last stream p50 {median(last):.2f} s"
        )
    return Check.of("streams", fact, wrong)


def _windows(faults: Iterable[Happened]) -> list[tuple[float, float]]:
    spans = []
    for row in faults:
        kind = "server" if row.fault.kind in SERVERS else "database" if row.fault.kind in DATABASE else None
        if kind is not None:
            spans.append((row.began_s, row.ended_s + WINDOW_S[kind]))
    return spans


def check_answers(ledger: Ledger) -> Check:
    """Requests fail in expected ways only, and only while or shortly after servers or the database were away."""
    spans = _windows(ledger.faults) + [(began_s, ended_s + WINDOW_S["server"]) for began_s, ended_s in ledger.down]
    wrong = []
    for row in ledger.answers:
        known = row.problem in TRANSPORT | UNAVAILABLE
        if not known or not any(row.began_s < end_s and row.ended_s > began_s for began_s, end_s in spans):
            wrong.append(_described(row, known))
    wrong += ledger.wrong
    problems = Counter(row.problem for row in ledger.answers)
    fact = f"{sum(ledger.done.values())} requests and operations succeeded; failed: " + (
        ", ".join(f"{problem} {count}" for problem, count in problems.most_common()) or "none"
    )
    return Check.of("answers", fact, wrong)


def _described(row: Answer, known: bool) -> str:
    reason = "outside of any fault" if known else "not an expected problem"
    return f"{row.what} at {row.began_s:.1f}–{row.ended_s:.1f} s: {row.problem}, {reason}"


def memory_ratio(samples: Iterable[Sample], kind: str, seconds: float) -> tuple[float, float] | None:
    """Memory early and late in the run, MiB: medians over processes of similar age; None without enough samples."""
    rows = [row for row in samples if row.kind == kind and (kind == "parent" or AGE_S[0] <= row.uptime_s <= AGE_S[1])]
    parts = [
        [row.rss_mib for row in rows if low * seconds <= row.at_s <= high * seconds] for low, high in (EARLY, LATE)
    ]
    if min(map(len, parts)) < LEAST_SAMPLES:
        return None
    return median(parts[0]), median(parts[1])


def check_memory(ledger: Ledger, seconds: float) -> Check:
    """Memory of parent, servers and workers late in the run is that of processes of the same age early in it."""
    wrong, facts = [], []
    for kind in ("parent", "server", "worker"):
        pair = memory_ratio(ledger.samples, kind, seconds)
        if pair is None:
            facts.append(f"{kind}: too few samples")
            if seconds >= LONG_S:
                wrong.append(f"{kind} was not sampled often enough")
            continue
        facts.append(f"{kind} {pair[0]:.0f} → {pair[1]:.0f} MiB ({pair[1] / pair[0]:.3f})")
        if pair[1] > FLAT * pair[0]:
            wrong.append(f"{kind} grew from {pair[0]:.0f} to {pair[1]:.0f} MiB; a factor of {FLAT:g} is allowed")
    if not wrong and all("too few" in fact for fact in facts):
        wrong.append("no process was sampled often enough")
    return Check.of("memory", "; ".join(facts), wrong)


def check_log(ledger: Ledger, lines: Iterable[str]) -> Check:
    """No process ended except by a fault, and nothing is logged as an error."""
    struck = {"server": SERVERS, "worker": WORKERS}
    most = {kind: sum(len(row.pids) for row in ledger.faults if row.fault.kind in of) for kind, of in struck.items()}
    wrong, ends = [], Counter[str]()
    for line in lines:
        if not line.startswith("{"):
            wrong += ["a traceback outside of a record"] * ("Traceback" in line)
            continue
        row = json.loads(line)
        event = str(row.get("event", ""))
        if "died" in event:
            ends[event.split(" ", maxsplit=1)[0]] += 1
            if row.get("code") not in EXPECTED_CODES:
                wrong.append(f"{event}: code {row.get('code')}")
        elif row.get("level") in ("error", "critical") and not EXPECTED_ERROR.search(event):
            wrong.append(f"error {line[:400]}")
    wrong += [f"{ends[kind]} times a {kind} ended, {most[kind]} by faults" for kind in most if ends[kind] > most[kind]]
    fact = ", ".join(f"{kind} ended and started again {count} times" for kind, count in sorted(ends.items()))
    return Check.of("log", fact or "no process ended", wrong)


def check_files(
    before: Mapping[str, list[str]], after: Mapping[str, list[str]], left: Iterable[str], *, verbs: int
) -> Check:
    """Open files are those of an idle server again, and no file is left over after the collection.

    Parameters
    ----------
    before, after : mapping of str to list of str
        What the open files of each kind of process refer to.
    left : iterable of str
        Files that nothing refers to.
    verbs : int
        Number of verbs that are served; each has one open file.
    """
    wrong, facts = [], []
    for kind, idle in before.items():
        own = Counter(name for name in after[kind] if not name.startswith("adverb-metrics-"))
        facts.append(f"{kind} {len(idle)} → {sum(own.values())} open")
        more = own - Counter(idle)
        new = max(verbs - idle.count("artifacts"), 0)
        if sum(more.values()) > MORE_FILES + new or more["artifacts"] > new + 1:
            wrong.append(f"{kind} has more open files than idle: {dict(more)}")
    wrong += [f"left over: {name}" for name in left]
    return Check.of("files", ", ".join(facts) + "; nothing is left over" * (not wrong), wrong)
