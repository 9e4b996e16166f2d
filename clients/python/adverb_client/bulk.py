"""Goals of many channels at once: one binary message for a whole crowd."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.channel import Channel
from adverb_client.wire import encode_bulk_adverbs

__all__ = ["BulkGoals", "Rows"]

Rows = npt.NDArray[Any] | Sequence[Sequence[float]]
MAX_CHECKED = 64
"""Sets of channels of which it is known that their goals can be sent."""


class BulkGoals:
    """Sends goals of many channels and keeps the last ones for a reconnection.

    Parameters
    ----------
    channels : mapping of int to Channel
        Open channels of the stream.
    post : callable
        Queues a message; a newer message with the same key replaces one that is not sent yet.
    """

    def __init__(self, channels: Mapping[int, Channel], post: Callable[[tuple[str, int | bytes], bytes], None]) -> None:
        self._channels, self._post = channels, post
        self._checked: dict[tuple[bytes, int], None] = {}
        self._goals = np.zeros((0, 0), np.float32)
        self._counts = np.zeros(0, np.intp)  # adverbs of the kept goal; 0: there is none

    def aim(self, channels: Sequence[Channel | int] | npt.NDArray[np.integer[Any]], adverbs: Rows) -> None:
        """Set the goals of channels; see :meth:`Stream.aim_many`."""
        if not isinstance(channels, np.ndarray):
            channels = np.array([getattr(channel, "number", channel) for channel in channels], np.int64)
        if len(channels) != len(adverbs):
            raise ValueError(f"{len(adverbs)} rows of adverbs for {len(channels)} channels")
        if isinstance(adverbs, np.ndarray) or len({len(row) for row in adverbs}) <= 1:
            self._aim(channels, np.asarray(adverbs))
            return
        lengths = [len(row) for row in adverbs]
        for length in dict.fromkeys(lengths):
            rows = [k for k, own in enumerate(lengths) if own == length]
            self._aim(channels[rows], np.array([adverbs[k] for k in rows]))

    def take(self, number: int) -> list[float] | None:
        """The kept goal of a channel, which is forgotten; None if there is none."""
        if number >= len(self._counts) or not self._counts[number]:
            return None
        goal: list[float] = self._goals[number, : self._counts[number]].tolist()
        self._counts[number] = 0
        return goal

    def channels_changed(self) -> None:
        """Check channels again at their next goal, since one was opened, switched or closed."""
        self._checked.clear()

    def _aim(self, numbers: npt.NDArray[np.integer[Any]], adverbs: npt.NDArray[Any]) -> None:
        if not numbers.size:
            return
        messages = encode_bulk_adverbs(numbers, adverbs)
        width, key = adverbs.shape[1], numbers.tobytes()
        if (key, width) not in self._checked:
            ready = self._check(numbers, width)
            if not ready.all():  # a channel that is switched takes its goal when the answer arrives
                for number, row in zip(numbers[~ready].tolist(), adverbs[~ready], strict=True):
                    self._channels[number].aim(row)
                self._aim(numbers[ready], adverbs[ready])
                return
            if len(self._checked) >= MAX_CHECKED:
                self._checked.clear()
            self._checked[key, width] = None
        self._keep(numbers, adverbs)
        for part, message in enumerate(messages):
            self._post((f"aim {part}", key), message)

    def _check(self, numbers: npt.NDArray[np.integer[Any]], width: int) -> npt.NDArray[np.bool_]:
        """Whether each channel takes goals now; raises ValueError for a channel that never takes this one."""
        ready = np.ones(len(numbers), bool)
        for row, number in enumerate(numbers.tolist()):
            channel = self._channels.get(number)
            if channel is None:
                raise ValueError(f"channel {number} is not open")
            ready[row] = channel.opened is not None and channel.switch is None
            if ready[row] and len(channel.info.adverbs) != width:
                raise ValueError(f"{width} adverbs given; channel {number} has {len(channel.info.adverbs)}")
        return ready

    def _keep(self, numbers: npt.NDArray[np.integer[Any]], adverbs: npt.NDArray[Any]) -> None:
        size, width = int(numbers.max()) + 1, adverbs.shape[1]
        if size > len(self._goals) or width > self._goals.shape[1]:
            old, counts = self._goals, self._counts
            self._goals = np.zeros((max(size, len(old)), max(width, old.shape[1])), np.float32)
            self._goals[: len(old), : old.shape[1]] = old
            self._counts = np.zeros(len(self._goals), np.intp)
            self._counts[: len(counts)] = counts
        self._goals[numbers, :width] = adverbs
        self._counts[numbers] = width
