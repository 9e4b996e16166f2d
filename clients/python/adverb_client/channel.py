"""A channel: one character of a stream, with its requested settings and its received poses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.errors import ResponseError
from adverb_client.jitter import JitterBuffer, Sample
from adverb_client.messages import ChannelOpened
from adverb_client.options import OpenOptions, checked
from adverb_client.skeleton import Skeleton, Space
from adverb_client.wire import Record, encode_adverbs

__all__ = ["Channel", "Post"]

Numbers = npt.NDArray[Any] | Sequence[float]
Post = Callable[[tuple[str, int], Mapping[str, Any] | bytes], None]
"""Queues a message. A newer message with the same key replaces one that is not sent yet."""


_SETTINGS = ("adverbs", "speed", "play", "loop", "fps", "half_life", "follow", "priority")


class Channel:
    """One character of a stream; created by ``Stream.open``.

    ``set``, ``aim`` and ``pose`` never block and may be called from any thread. Settings that are made without a
    connection are sent after the reconnection.

    Attributes
    ----------
    number : int
    opened : ChannelOpened or None
        The server's latest description of the channel.
    error : ResponseError or None
        Why the channel could not be reopened after a reconnection.
    """

    def __init__(
        self,
        number: int,
        verb: str,
        options: OpenOptions,
        *,
        buffer: JitterBuffer,
        post: Post,
        now: Callable[[], float],
        bulk_goal: Callable[[int], list[float] | None],
    ) -> None:
        self.number = number
        self.opened: ChannelOpened | None = None
        self.error: ResponseError | None = None
        self.desired: dict[str, Any] = {**checked(options), "verb": verb}
        self.has_all_adverbs = "adverbs" in self.desired  # otherwise only those that were set
        self.buffer, self.lock = buffer, asyncio.Lock()
        self.observers: list[Callable[[float, Record], None]] = []  # called with tick time and record
        self.switch: dict[str, Any] | None = None  # sent, without an answer so far
        self.pending_phase: float | None = None  # a phase that was set; the server may not have it
        self._deferred_aim: list[float] | None = None  # goal set during a switch
        self._deferred: dict[str, float] = {}  # adverbs set during a switch
        self._post, self._now, self._take_bulk_goal = post, now, bulk_goal

    @property
    def verb(self) -> str:
        """The current verb."""
        return self.opened.verb if self.opened is not None else str(self.desired["verb"])

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton, in the channel's frame."""
        return self.info.skeleton

    @property
    def info(self) -> ChannelOpened:
        """The server's description of the channel: adverbs, skeleton, keytimes, encoding.

        Raises
        ------
        RuntimeError
            Before the channel is open.
        """
        if self.opened is None:
            raise RuntimeError(f"channel {self.number} is not open yet")
        return self.opened

    def pose(self, at: float | None = None) -> Sample | None:
        """The pose to display.

        Parameters
        ----------
        at : float, optional
            On the clock of ``time.monotonic``, seconds; now by default.

        Returns
        -------
        Sample or None
            None before the first frame has arrived.
        """
        return self.buffer.sample(self._now() if at is None else at)

    def positions(self, sample: Sample) -> npt.NDArray[np.float64]:
        """Joint positions (J, 3) of a pose, in the frame's unit of length; for channels with all joints.

        Raises
        ------
        ValueError
            If the channel's encoding is ``weights``, or it has only some of the joints.
        """
        if sample.root is None or sample.rotations is None:
            raise ValueError("a channel of weights has no pose; blend the verb's examples")
        space: Space = "global" if self.info.space == "global" else "local"
        return self.info.skeleton.positions(sample.root, sample.rotations, space)

    def aim(self, adverbs: Numbers) -> None:
        """Set the goal: all adverbs, as a binary message of 4 + 4·D bytes that replaces an unsent one.

        Parameters
        ----------
        adverbs : (D,) numbers
            In the order of ``info.adverbs``, in their units.

        Raises
        ------
        ValueError
            If their number is not the verb's, or one of them is not finite.
        """
        numbers = [float(number) for number in adverbs]
        content = encode_adverbs(self.number, numbers)
        if self.switch is not None or self.opened is None:
            self._deferred_aim = numbers  # the next verb's number of adverbs is not known yet
            return
        names = [adverb.name for adverb in self.opened.adverbs]
        if len(numbers) != len(names):
            raise ValueError(f"{len(numbers)} adverbs given; {self.verb!r} has {len(names)}: {', '.join(names)}")
        self._take_bulk_goal(self.number)  # this one is newer
        self.desired["adverbs"], self.has_all_adverbs = dict(zip(names, numbers, strict=True)), True
        self._post(("aim", self.number), content)

    def set(
        self,
        *,
        adverbs: Mapping[str, float] | None = None,
        speed: float | None = None,
        phase: float | None = None,
        play: bool | None = None,
        loop: bool | None = None,
        fps: int | None = None,
        half_life: float | None = None,
        follow: bool | None = None,
        priority: float | None = None,
    ) -> None:
        """Change the given settings; see :class:`OpenOptions`. ``adverbs`` may name some; ``phase`` seeks at once.

        Raises
        ------
        ValueError
            If a value is out of range or not finite.
        """
        given = {"adverbs": adverbs, "speed": speed, "phase": phase, "play": play, "loop": loop, "fps": fps}
        changed = checked({**given, "half_life": half_life, "follow": follow, "priority": priority})
        if "adverbs" in changed:
            self._apply_bulk_goal()
            known = self._deferred if self.switch is not None else self.desired.setdefault("adverbs", {})
            known.update(changed["adverbs"])
        self.desired |= {name: value for name, value in changed.items() if name != "adverbs"}
        self.pending_phase = changed.get("phase", self.pending_phase)
        if "fps" in changed:
            self.buffer.interval_s = 1.0 / changed["fps"]
        if changed:
            self._post(("set", self.number), {"op": "set", "channel": self.number, **changed})

    def apply_opened(self, opened: ChannelOpened) -> None:
        """Apply an ``opened`` message."""
        restarted = self.opened is None or (self.switch is None and not opened.resumed)
        self.opened, self.error = opened, None
        if self.switch is not None and opened.verb == self.switch["verb"]:
            self.commit_switch()
        self.buffer.interval_s, self.buffer.looping = 1.0 / opened.fps, opened.looping
        if restarted:
            self.buffer.restart()
        if self._deferred_aim is not None and self.switch is None:
            aimed, self._deferred_aim = self._deferred_aim, None
            if len(aimed) == len(opened.adverbs):
                self.aim(aimed)

    def _apply_bulk_goal(self) -> None:
        """Make the goal that was set together with other channels the goal of this channel."""
        goal = self._take_bulk_goal(self.number)
        if goal is not None and self.opened is not None:
            names = [adverb.name for adverb in self.opened.adverbs]
            self.desired["adverbs"], self.has_all_adverbs = dict(zip(names, goal, strict=True)), True

    def commit_switch(self) -> None:
        """Make the verb, adverbs and method of the pending switch those of the channel."""
        if self.switch is None:
            return
        self._take_bulk_goal(self.number)  # of the verb before
        for name in ("adverbs", "method"):
            self.desired.pop(name, None)
        self.desired |= {name: self.switch[name] for name in ("verb", "adverbs", "method") if name in self.switch}
        self.has_all_adverbs = "adverbs" in self.desired
        if self._deferred:
            self.desired["adverbs"] = {**self.desired.get("adverbs", {}), **self._deferred}
        self.clear_switch()

    def clear_switch(self) -> None:
        """Forget the pending switch."""
        self.switch = None
        self._deferred = {}

    def open_message(self) -> dict[str, Any]:
        """The message that opens the channel with its current settings at its last known phase."""
        self._apply_bulk_goal()
        last = self.buffer.last
        start = {} if last is None else {"phase": min(max(last.phase, 0.0), 1.0)}
        if self.pending_phase is not None:
            start = {"phase": self.pending_phase}
        settings = {name: value for name, value in self.desired.items() if name != "adverbs" or self.has_all_adverbs}
        return {"op": "open", "channel": self.number, **settings, **start}

    def set_message(self) -> dict[str, Any] | None:
        """The message that applies all settings to a resumed channel; None where there are none."""
        self._apply_bulk_goal()
        known = {name: self.desired[name] for name in _SETTINGS if name in self.desired}
        if self.pending_phase is not None:
            known["phase"] = self.pending_phase
        return {"op": "set", "channel": self.number, **known} if known else None
