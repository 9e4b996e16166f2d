"""A ticker: the channels of some sessions, stepped together, one message per session.

A ticker's plan holds everything that stays the same from tick to tick as arrays, so that a tick of a thousand
characters is a few compiled calls and one ``send`` per session. It is made anew when a channel comes, goes or changes.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from service.metrics import Metrics
from service.stream.group import Group
from service.stream.session import Channel, Session
from service.wire import HEADER_WORDS, NEW_VERSION, U32, Targets, pack
from verbs.conventions import F64, I64
from verbs.kernels import pose as kernels
from verbs.runtime.characters import Frames

__all__ = ["Ticker"]

MOVING_ROWS = 48
"""Characters that are stepped in one call while goals move; more would block the event loop for over a millisecond."""

RESTING_ROWS, MAX_MOVING = 128, 24
"""Characters that are stepped in one call, if at most so many of them follow a moving goal."""

SLICE_S = 0.0005
"""Time after which a tick yields to the event loop."""

MAX_PLANS = 32
_TOGETHER_S = 1e-6
_MARGIN = 1e-6
"""Of phase: a first step begins a little before where it starts, see :func:`verbs.kernels.character_state.advance`."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Characters of one group and one fps, and the places of their records."""

    group: Group
    fps: int
    channels: list[Channel]
    slots: I64
    targets: Targets
    needs_global: bool
    pieces: tuple[_Part, ...] = ()

    def calls(self) -> tuple[_Part, ...]:
        """The parts that are stepped in one call each."""
        if self.pieces and self.group.characters.restless(self.slots) > MAX_MOVING:
            return self.pieces
        return (self,)


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """A session's message: its range in the plan's words and its number of records."""

    session: Session
    start: int
    stop: int
    records: int


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    parts: list[_Part]
    messages: list[_Slice]
    words: U32


class Ticker:
    """Channels that tick together.

    Parameters
    ----------
    origin_s : float
        Where its ticks count from, on the event loop's clock.
    metrics : Metrics
    """

    def __init__(self, origin_s: float, metrics: Metrics) -> None:
        self.origin_s, self.lock, self.sessions = origin_s, asyncio.Lock(), 0
        self.channels: dict[int, set[Channel]] = {}
        self._ticks: dict[int, int] = {}
        self._plans: dict[frozenset[int], _Plan] = {}
        self._metrics = metrics

    def __len__(self) -> int:
        return sum(len(some) for some in self.channels.values())

    @property
    def load(self) -> int:
        """Number of characters, or of sessions if these have none yet."""
        return max(len(self), self.sessions)

    def add(self, channel: Channel, now_s: float) -> None:
        """Add a channel; its first tick is the next one of its fps."""
        fps = channel.fps
        if fps not in self.channels:
            self.channels[fps] = set()
            self._ticks[fps] = int(np.floor((now_s - self.origin_s) * fps))
        self.channels[fps].add(channel)
        self._plans.clear()

    def drop(self, channel: Channel) -> None:
        """Remove a channel."""
        some = self.channels[channel.fps]
        some.discard(channel)
        if not some:
            del self.channels[channel.fps], self._ticks[channel.fps]
        self._plans.clear()

    def changed(self) -> None:
        """Discard the plans, since a channel or a session changed."""
        self._plans.clear()

    def due_s(self) -> float | None:
        """When the next tick is due; None where there are no channels."""
        if not self._ticks:
            return None
        return self.origin_s + min((tick + 1) / fps for fps, tick in self._ticks.items())

    async def tick(self, now_s: float, clock_ns: int) -> None:
        """Step every channel that is due, and send the messages.

        Parameters
        ----------
        now_s : float
        clock_ns : int
            The server's clock at the zero of the event loop's clock.
        """
        async with self.lock:
            due_s = self.due_s()
            if due_s is None:
                return
            steps = self._count(due_s, now_s)
            chosen = frozenset(steps)
            plan = self._plans.get(chosen)
            if plan is None:
                if len(self._plans) >= MAX_PLANS:
                    self._plans.clear()
                plan = self._plans[chosen] = _plan(channel for fps in chosen for channel in self.channels[fps])
            pause = time.perf_counter() + SLICE_S
            for part in (call for whole in plan.parts for call in whole.calls()):
                self._step(part, steps[part.fps] / part.fps, plan.words)
                if time.perf_counter() > pause:
                    await asyncio.sleep(0)
                    pause = time.perf_counter() + SLICE_S
            missed = max(steps.values()) - 1
            if missed:  # the server was too slow: missed ticks are skipped and counted as dropped
                for message in plan.messages:
                    message.session.dropped += missed
                self._metrics.count_skipped(missed * len(plan.messages))
            shown_s = self.origin_s + max(self._ticks[fps] / fps for fps in steps)
            await self._send(plan, shown_s, clock_ns + int(shown_s * 1e9), pause)

    def _count(self, due_s: float, now_s: float) -> dict[int, int]:
        """Ticks by fps since the last one, for every fps that is due; missed ones are skipped."""
        steps = {}
        for fps, tick in self._ticks.items():
            if (tick + 1) / fps <= due_s - self.origin_s + _TOGETHER_S:
                late = int((now_s - due_s) * fps)
                steps[fps] = 1 + max(late, 0)
                self._ticks[fps] += steps[fps]
        return steps

    def _step(self, part: _Part, step_s: float, words: U32) -> None:
        group = part.group
        entry = group.entry
        frames = group.characters.step(part.slots, step_s)
        rotations = _global_rotations(group, frames) if part.needs_global else frames.rotations
        pack(frames, rotations, entry.version, part.targets, words)
        self._metrics.count_poses(entry, frames.blend, len(part.slots))
        _send_events(part, frames)

    async def _send(self, plan: _Plan, due_s: float, due_ns: int, pause: float) -> None:
        whole, sent, dropped = plan.words.data.cast("B"), 0, 0
        for message in plan.messages:
            if message.session.send_poses(whole[message.start : message.stop], message.records, due_ns):
                sent += 1
            elif message.session.connected:
                dropped += 1
            if time.perf_counter() > pause:
                await asyncio.sleep(0)
                pause = time.perf_counter() + SLICE_S
        late_s = time.monotonic() - due_s
        self._metrics.count_messages(sent, dropped, max(late_s, 0.0))


def _plan(channels: Iterable[Channel]) -> _Plan:
    """Arrange the messages of channels that are due together."""
    by_session: dict[Session, list[Channel]] = {}
    for channel in channels:
        by_session.setdefault(channel.session, []).append(channel)
    rows: dict[tuple[tuple[str, int, str], int], list[tuple[Channel, int]]] = {}
    messages, word = [], 0
    for session, some in by_session.items():
        start, word = word, word + HEADER_WORDS
        for channel in sorted(some, key=lambda one: one.number):
            here = word if session.connected else -1
            rows.setdefault((channel.group.key, channel.fps), []).append((channel, here))
            word += channel.layout.words
        messages.append(_Slice(session, 4 * start, 4 * word, len(some)))
    words = np.zeros(word, np.uint32)
    parts = [_part(pairs[first:stop]) for pairs in rows.values() for first, stop in _cuts(len(pairs), RESTING_ROWS)]
    return _Plan(parts, messages, words)


def _cuts(count: int, most: int) -> list[tuple[int, int]]:
    """Bounds of the fewest pieces of nearly equal length."""
    pieces = -(-count // most)
    return [(k * count // pieces, (k + 1) * count // pieces) for k in range(pieces)]


def _part(pairs: list[tuple[Channel, int]]) -> _Part:
    channels = [channel for channel, _ in pairs]
    layouts = [channel.layout for channel in channels]
    whole = _Part(
        channels[0].group,
        channels[0].fps,
        channels,
        np.array([channel.slot for channel in channels], np.int64),
        Targets.of(layouts, [at for _, at in pairs], [channel.head() for channel in channels]),
        any(layout.space == "global" for layout in layouts),
    )
    if len(pairs) <= MOVING_ROWS:
        return whole
    return replace(whole, pieces=tuple(_piece(whole, *cut) for cut in _cuts(len(pairs), MOVING_ROWS)))


def _piece(whole: _Part, first: int, stop: int) -> _Part:
    """Some characters of a part."""
    rows = slice(first, stop)
    targets = whole.targets.part(first, stop)
    return replace(whole, channels=whole.channels[rows], slots=whole.slots[rows], targets=targets)


def _global_rotations(group: Group, frames: Frames) -> F64:
    """Global rotations (B, J, 4)."""
    skeleton = group.entry.verb.skeleton
    rotations, positions = np.empty_like(frames.rotations), np.empty((*frames.rotations.shape[:2], 3))
    kernels.forward(frames.root, frames.rotations, skeleton.parents, skeleton.offsets, rotations, positions)
    return rotations


def _send_events(part: _Part, frames: Frames) -> None:
    """Send events of passed keytimes and ended motions; clear flags that are sent once."""
    verb = part.group.entry.verb
    progress = frames.progress
    for b in np.flatnonzero(progress["passed"] + progress["ended"]):
        channel = part.channels[b]
        for name, phase in _passed(verb.keytime_names, verb.phases.tolist(), verb.looping, progress[b]):
            channel.session.send_text({"op": "event", "channel": channel.number, "name": name, "phase": phase})
        if progress["ended"][b]:
            channel.session.send_text({"op": "end", "channel": channel.number})
    heads = part.targets.heads
    for b in np.flatnonzero(heads >> 24):
        part.channels[b].flags &= ~NEW_VERSION
        heads[b] = part.channels[b].head()


def _passed(names: tuple[str, ...], phases: list[float], looping: bool, step: np.void) -> Iterator[tuple[str, float]]:
    """Keytimes between the two ends of a step, in the order in which they passed; at most two cycles of them."""
    start, stop = float(step["start"]), float(step["stop"])
    marks = list(zip(names, phases, strict=True))[: -1 if looping else None]
    low, high = min(start, stop), max(start, stop)
    first = int(np.floor(low + _MARGIN))
    cycles = range(first, first + 3) if low < -_MARGIN or high > 1.0 + _MARGIN else (0,)
    found = [
        (cycle + phase, name, phase)
        for cycle in cycles
        for name, phase in marks
        if (start < cycle + phase <= stop) or (stop <= cycle + phase < start)
    ]
    for _, name, phase in sorted(found, reverse=stop < start):
        if high > low:
            yield name, phase
