"""Ticks: which channels are due when, the next tick prepared ahead of time, and its messages sent when it is due.

Ticks of a rate are at integer multiples of its period from one origin, so all channels of a rate are due together.
Everything here runs in the engine's thread; the loops over characters and messages are compiled and hold no lock.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.metrics import Metrics
from service.packing import Step, pack_step
from service.stream import kernels, plan
from service.stream.connection import DirectConnection, LoopConnection
from service.stream.kernels import NOT_SENT
from service.stream.plan import Part, Plan
from service.stream.session import LineTable, Session
from service.wire import HEADER_WORDS, NEW_VERSION, U32, support_flags
from verbs.conventions import I64

__all__ = ["Prepared", "Ticks"]

MAX_PLANS = 32
AHEAD_S = 0.001
"""Time between the end of the preparation of a tick and its due time, seconds."""

FALL = 0.9
"""Estimates of the time that a preparation takes fall by this factor in each tick; they rise at once."""

_TOGETHER_S = 1e-6


@dataclass(slots=True, eq=False)
class Prepared:
    """A tick whose messages are ready.

    Parameters
    ----------
    plan : Plan
    due_s : float
        On the monotonic clock.
    texts : dict
        Text messages of sessions, which precede their pose messages.
    """

    plan: Plan
    due_s: float
    texts: dict[Session, list[dict[str, Any]]] = field(default_factory=dict)


class Ticks:
    """The schedule of all channels of a server.

    Parameters
    ----------
    origin_s : float
        Where ticks count from, on the monotonic clock.
    table : LineTable
    metrics : Metrics
    """

    def __init__(self, origin_s: float, table: LineTable, metrics: Metrics) -> None:
        self.origin_s, self._table, self._metrics = origin_s, table, metrics
        self._counts: Counter[int] = Counter()
        self._ticks: dict[int, int] = {}
        self._plans: dict[frozenset[int], Plan] = {}

    @property
    def characters(self) -> int:
        """Number of channels."""
        return sum(self._counts.values())

    def add(self, session: Session, fps: int, now_s: float) -> None:
        """Count a channel of a rate; its first tick is the next one."""
        if not self._counts[fps]:
            self._ticks[fps] = int(np.floor((now_s - self.origin_s) * fps))
        self._counts[fps] += 1
        session.rates[fps] += 1
        self.changed(session)

    def drop(self, session: Session, fps: int) -> None:
        """Count a channel of a rate no more."""
        for counts in (self._counts, session.rates):
            counts[fps] -= 1
            if not counts[fps]:
                del counts[fps]
        if fps not in self._counts:
            del self._ticks[fps]
        self.changed(session)

    def changed(self, session: Session) -> None:
        """Discard the plans, since the channels of a session changed."""
        session.changed()
        self._plans.clear()

    def reconnected(self) -> None:
        """Discard the plans, since a session has another connection or none."""
        self._plans.clear()

    def due_s(self) -> float | None:
        """When the next tick is due; None where there are no channels."""
        if not self._ticks:
            return None
        return self.origin_s + min((tick + 1) / fps for fps, tick in self._ticks.items())

    def lead_s(self, due_s: float) -> float:
        """How long before it is due the preparation of a tick starts."""
        found = self._plans.get(frozenset(self._due(due_s)))
        return AHEAD_S + (found.cost_s if found is not None else 0.0)

    def _due(self, due_s: float) -> list[int]:
        latest = due_s - self.origin_s + _TOGETHER_S
        return [fps for fps, tick in self._ticks.items() if (tick + 1) / fps <= latest]

    def prepare(self, due_s: float, now_s: float, sessions: Mapping[str, Session]) -> Prepared:
        """Step every channel that is due, and write its record."""
        started_s = time.perf_counter()
        steps = self._advance(due_s, now_s)
        rates = frozenset(steps)
        found = self._plans.get(rates)
        if found is None:
            if len(self._plans) >= MAX_PLANS:
                self._plans.clear()
            found = self._plans[rates] = plan.make(sessions.values(), rates)
        prepared = Prepared(found, self.origin_s + max(self._ticks[fps] / fps for fps in steps))
        missed = max(steps.values()) - 1
        if missed:  # the server was too slow: missed ticks are skipped and counted as dropped
            for session in found.sessions:
                session.count_dropped(missed)
            self._metrics.count_skipped(missed * len(found.sessions))
        step_s = {fps: count / fps for fps, count in steps.items()}
        for budgeted in found.budgeted:
            _choose(found, budgeted, max(step_s.values()))
        parts = found.awake(step_s)
        thinned = found.clear()
        for part in parts:
            step = pack_step(
                part.group.characters, part.slots, step_s[part.fps],
                part.group.entry.version, part.targets, found.words,
            )  # fmt: skip
            method = part.group.characters.method
            self._metrics.count_frames(part.group.entry, method, step.error, step.clamped, len(part.slots))
            if len(part.supported):
                _add_support(part, found.words)
            for row in part.vmc.tolist():
                sender = part.channels[row].vmc
                if sender is not None:
                    sender.send(part.group.characters, int(part.slots[row]), prepared.due_s)
            _collect_texts(part, step, prepared.texts)
            self._clear_flags(part)
        for message in thinned:
            found.thin(message, prepared.due_s)
        found.cost_s = max(time.perf_counter() - started_s, FALL * found.cost_s)
        return prepared

    def _advance(self, due_s: float, now_s: float) -> dict[int, int]:
        """Ticks by fps since the last one, for every fps that is due; missed ones are skipped."""
        steps = {}
        for fps in self._due(due_s):
            late = int((now_s - due_s) * fps)
            steps[fps] = 1 + max(late, 0)
            self._ticks[fps] += steps[fps]
        return steps

    def _clear_flags(self, part: Part) -> None:
        """Clear flags that are sent once."""
        for row in np.flatnonzero((part.targets.heads >> 24 != 0) & (part.targets.at >= 0)).tolist():
            channel = part.channels[row]
            channel.flags &= ~NEW_VERSION
            self.changed(channel.session)

    def send(self, prepared: Prepared, epoch_ns: int) -> list[Session]:
        """Send the messages of a tick; return the sessions for which something waits.

        Parameters
        ----------
        prepared : Prepared
        epoch_ns : int
            The server's clock at the zero of the monotonic clock.
        """
        found, due_ns = prepared.plan, epoch_ns + int(prepared.due_s * 1e9)
        for session, texts in prepared.texts.items():
            for message in texts:
                if message.get("items", True):
                    session.send_text(message)
        left = np.empty(len(found.rows), np.int64)
        kernels.send_messages(
            found.data, found.words, found.starts, found.heads, found.sizes, found.rows, self._table.lines, due_ns, left
        )
        late_s = max(time.monotonic() - prepared.due_s, 0.0)
        self._count(found, left, late_s)
        unfinished = np.flatnonzero(left).tolist()
        return [found.sessions[index] for index in unfinished if self._finish(found, index, int(left[index]), due_ns)]

    def _finish(self, found: Plan, index: int, left: int, due_ns: int) -> bool:
        """Keep what a message left, or count it as dropped; return whether something waits."""
        session = found.sessions[index]
        connection = session.connection
        if left == NOT_SENT:
            session.was_dropped(due_ns)
            session.forget_sent()
            return session.refresh()
        start = 4 * int(found.starts[index])
        stop = start + int(found.sizes[index])
        if isinstance(connection, DirectConnection):
            connection.keep(found.data[stop - left : stop].tobytes())
        elif isinstance(connection, LoopConnection):
            connection.post(found.data[start:stop].tobytes())
        return session.refresh()

    def _count(self, found: Plan, left: I64, late_s: float) -> None:
        due = found.sizes > 0
        sent = int(np.count_nonzero(due & (left != NOT_SENT)))
        lost = np.flatnonzero(left == NOT_SENT).tolist()
        dropped = sum(found.sessions[index].connected for index in lost)
        self._metrics.count_messages(sent, dropped, late_s)


def _choose(found: Plan, budgeted: plan.Budgeted, step_s: float) -> None:
    """Place the records that a budget allows, and leave out the others."""
    session = budgeted.session
    assert session.interest is not None  # only such sessions are budgeted
    head = 10
    chosen = session.interest.choose(
        budgeted.numbers, budgeted.priorities(), 4 * budgeted.sizes, budgeted.positions(),
        fixed=4 * HEADER_WORDS + head, step_s=step_s,
    )  # fmt: skip
    sizes = budgeted.sizes * chosen
    at = int(found.starts[budgeted.index]) + HEADER_WORDS + np.cumsum(sizes) - sizes
    at[chosen == 0] = -1
    for part, row, ranks in budgeted.pieces:
        part.targets.at[row : row + len(ranks)] = at[ranks]
    count = int(chosen.sum())
    found.set_message(budgeted.index, count, 4 * (HEADER_WORDS + int(sizes.sum())) if count else 0)


def _add_support(part: Part, words: U32) -> None:
    """Write the support of a part's characters into the flags of their records."""
    rows = part.supported[part.targets.at[part.supported] >= 0]  # without those that a byte budget leaves out
    flags = support_flags(part.group.characters.support(part.slots[rows]))
    words[part.targets.at[rows]] |= flags.astype(np.uint32) << 24


def _collect_texts(part: Part, step: Step, texts: dict[Session, list[dict[str, Any]]]) -> None:
    """Add the events of passed keytimes and ended motions: one message of events a session, then the ends."""
    rows, marks = part.group.passed(step, part.wanted)
    names = part.group.events
    for row, mark in zip(rows, marks, strict=True):
        channel = part.channels[row]
        _texts_of(texts, channel.session)[0]["items"].append({"channel": channel.number, **names[mark]})
    for row in np.flatnonzero(step.progress["ended"]).tolist():
        channel = part.channels[row]
        _texts_of(texts, channel.session).append({"op": "end", "channel": channel.number})


def _texts_of(texts: dict[Session, list[dict[str, Any]]], session: Session) -> list[dict[str, Any]]:
    return texts.setdefault(session, [{"op": "events", "items": []}])
