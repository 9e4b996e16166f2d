"""A channel: one character of a stream, as its client knows and wants it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

import numpy as np
import numpy.typing as npt

from adverb_client.errors import Refused
from adverb_client.jitter import JitterBuffer, Sample
from adverb_client.messages import Opened
from adverb_client.skeleton import Skeleton, Space
from adverb_client.wire import encode_adverbs

__all__ = ["Channel", "OpenOptions", "Post"]

Numbers = npt.NDArray[Any] | Sequence[float]
Post = Callable[[tuple[str, int], Mapping[str, Any] | bytes], None]
"""Sends a message soon: a key, by which a newer message replaces one that is not sent yet, and the message."""


class OpenOptions(TypedDict, total=False):
    """What may be said about a channel when it is opened; the server has defaults for all of it.

    Parameters
    ----------
    adverbs : mapping of str to float
        All of them, in their units.
    fps : int
        Frames per second, 1–120.
    method : str
    space : str
        ``local`` or ``global``.
    encoding : str
        ``f32``, ``q48`` (a third of the bytes, within 0.00015 rad) or ``weights`` (the client blends).
    frame : str
        Axes and lengths: ``gltf``, ``unity``, ``unreal`` or ``zup``.
    joints : sequence of str
        Only these, in this order.
    phase : float
        Where to start, 0–1.
    speed : float
        1 is as captured; negative goes backwards.
    play : bool
        Whether the phase goes on.
    loop : bool
        Whether to start again at the end.
    half_life : float
        How lazily what is shown runs after the adverbs that are set, seconds.
    follow : bool
        Whether the effector of a held channel stays on the goal.
    """

    adverbs: Mapping[str, float]
    fps: int
    method: str
    space: Space
    encoding: Literal["f32", "q48", "weights"]
    frame: Literal["gltf", "unity", "unreal", "zup"]
    joints: Sequence[str]
    phase: float
    speed: float
    play: bool
    loop: bool
    half_life: float
    follow: bool


_LASTING = ("adverbs", "speed", "play", "loop", "fps", "half_life", "follow")


class Channel:
    """One character of a stream; made by ``open`` of a stream.

    ``set``, ``aim`` and ``pose`` never wait and may be called from any thread. What is set while the connection is
    lost takes effect when it is found again.

    Attributes
    ----------
    number : int
    opened : Opened or None
        What the server last told about it.
    refused : Refused or None
        Why the server does not show it any more, where it could not be opened anew after a lost connection.
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
    ) -> None:
        self.number = number
        self.opened: Opened | None = None
        self.refused: Refused | None = None
        self.wanted: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
        self.wanted |= {"verb": verb}
        if "joints" in self.wanted:
            self.wanted["joints"] = list(self.wanted["joints"])
        self.whole = "adverbs" in self.wanted  # all adverbs are known here, not just some that were set
        if self.whole:
            self.wanted["adverbs"] = _finite(self.wanted["adverbs"])
        self.buffer, self.lock = buffer, asyncio.Lock()
        self.switch: dict[str, Any] | None = None  # asked for and not answered yet
        self.jump: float | None = None  # a phase that was set and that the server may not know of
        self._aimed: list[float] | None = None  # adverbs that came while it was not known how many there are
        self._later: dict[str, float] = {}  # adverbs that were set while a switch was under way
        self._post, self._now = post, now

    @property
    def verb(self) -> str:
        """The verb that is shown."""
        return self.opened.verb if self.opened is not None else str(self.wanted["verb"])

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton, in the channel's frame."""
        return self.told.skeleton

    @property
    def told(self) -> Opened:
        """What the server told about the channel when it was opened."""
        if self.opened is None:
            raise RuntimeError(f"channel {self.number} is not open yet")
        return self.opened

    def pose(self, at: float | None = None) -> Sample | None:
        """The pose to show.

        Parameters
        ----------
        at : float, optional
            On the clock of ``time.monotonic``, seconds; now by default.

        Returns
        -------
        Sample or None
            None before the first frame has come.
        """
        return self.buffer.sample(self._now() if at is None else at)

    def positions(self, sample: Sample) -> npt.NDArray[np.float64]:
        """Where the joints (J, 3) of a pose are, in the frame's unit of length; of channels with all joints."""
        if sample.root is None or sample.rotations is None:
            raise ValueError("a channel of weights has no pose; blend the verb's examples")
        space: Space = "global" if self.told.space == "global" else "local"
        return self.told.skeleton.positions(sample.root, sample.rotations, space)

    def aim(self, adverbs: Numbers) -> None:
        """Set all adverbs, as 4 + 4·D bytes; one that is not sent yet is replaced.

        Parameters
        ----------
        adverbs : (D,) numbers
            In the order of ``told.adverbs``, in their units.

        Raises
        ------
        ValueError
            If they are not as many as the verb's, or not finite.
        """
        numbers = [float(number) for number in adverbs]
        content = encode_adverbs(self.number, numbers)
        if self.switch is not None or self.opened is None:
            self._aimed = numbers  # how many the next verb takes is not known yet
            return
        names = [adverb.name for adverb in self.opened.adverbs]
        if len(numbers) != len(names):
            raise ValueError(f"{len(numbers)} adverbs are given; {self.verb!r} has {len(names)}: {', '.join(names)}")
        self.wanted["adverbs"], self.whole = dict(zip(names, numbers, strict=True)), True
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
    ) -> None:
        """Change what is given; see :class:`OpenOptions`. Some adverbs are enough; a phase is gone to at once.

        Raises
        ------
        ValueError
            If a number is not finite.
        """
        given = {"speed": speed, "phase": phase, "half_life": half_life}
        changed: dict[str, Any] = {name: float(number) for name, number in given.items() if number is not None}
        _finite(changed)
        rest = {"play": play, "loop": loop, "fps": fps, "follow": follow}
        changed |= {name: value for name, value in rest.items() if value is not None}
        if adverbs is not None:
            changed["adverbs"] = _finite(adverbs)
            known = self._later if self.switch is not None else self.wanted.setdefault("adverbs", {})
            known.update(changed["adverbs"])
        self.wanted |= {name: value for name, value in changed.items() if name != "adverbs"}
        self.jump = changed.get("phase", self.jump)
        if fps is not None:
            self.buffer.interval_s = 1.0 / fps
        if changed:
            self._post(("set", self.number), {"op": "set", "channel": self.number, **changed})

    def answered(self, opened: Opened) -> None:
        """Take what the server tells about the channel now."""
        anew = self.opened is None or (self.switch is None and not opened.resumed)
        self.opened, self.refused = opened, None
        if self.switch is not None and opened.verb == self.switch["verb"]:
            self.become()
        self.buffer.interval_s, self.buffer.looping = 1.0 / opened.fps, opened.looping
        if anew:
            self.buffer.restart()
        if self._aimed is not None and self.switch is None:
            aimed, self._aimed = self._aimed, None
            if len(aimed) == len(opened.adverbs):
                self.aim(aimed)

    def become(self) -> None:
        """Want for good what a switch asked for, if there is one."""
        if self.switch is None:
            return
        for name in ("adverbs", "method"):
            self.wanted.pop(name, None)
        self.wanted |= {name: self.switch[name] for name in ("verb", "adverbs", "method") if name in self.switch}
        self.whole = "adverbs" in self.wanted
        if self._later:
            self.wanted["adverbs"] = {**self.wanted.get("adverbs", {}), **self._later}
        self.forget_switch()

    def forget_switch(self) -> None:
        """No switch is under way any more."""
        self.switch = None
        self._later = {}

    def opening(self) -> dict[str, Any]:
        """The message that opens the channel as it is wanted, from where it was last seen."""
        last = self.buffer.last
        where = {} if last is None else {"phase": min(max(last.phase, 0.0), 1.0)}
        if self.jump is not None:
            where = {"phase": self.jump}
        wanted = {name: value for name, value in self.wanted.items() if name != "adverbs" or self.whole}
        return {"op": "open", "channel": self.number, **wanted, **where}

    def changes(self) -> dict[str, Any] | None:
        """The message that brings a channel that went on without us to what is wanted; None where nothing is."""
        known = {name: self.wanted[name] for name in _LASTING if name in self.wanted}
        if self.jump is not None:
            known["phase"] = self.jump
        return {"op": "set", "channel": self.number, **known} if known else None


def _finite(numbers: Mapping[str, float]) -> dict[str, float]:
    found = {name: float(number) for name, number in numbers.items()}
    if not all(math.isfinite(number) for number in found.values()):
        raise ValueError(f"only finite numbers can be set: {found}")
    return found
