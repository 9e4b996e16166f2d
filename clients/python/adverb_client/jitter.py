"""The jitter buffer: frames come when they come, poses are wanted when they are wanted.

A pose is shown a little later than it was due: by the interval between two frames, so that there is a frame on either
side to go between, and by the lateness that nearly all frames keep to. This delay follows what is observed, slowly
enough that nobody sees time run faster or slower. Where frames fail to come, the motion goes on for a moment as it
went, and then holds.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from adverb_client import quat
from adverb_client.clock import Lateness
from adverb_client.records import CLAMPED, IN_TRANSITION, LAST
from adverb_client.wire import Record

__all__ = ["Delays", "JitterBuffer", "Sample"]

F32 = npt.NDArray[np.float32]

FRAMES_KEPT = 128
SNAP_S = 0.5
"""A playhead that is further off than this jumps; nobody would believe it if it ran."""
SLOWER, FASTER = 0.20, 0.10
"""Shares by which shown time may run slower or faster than real time while the delay changes."""
LONGEST_STEP = 3.5
"""Two frames further apart than so many intervals tell nothing about the speed at the end."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Bounds of a jitter buffer, seconds.

    Parameters
    ----------
    least_s, most_s : float
        Between which the delay stays.
    extrapolate_s : float
        How long motion goes on where no frame has come.
    """

    least_s: float = 0.0
    most_s: float = 0.25
    extrapolate_s: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A pose at the instant that is shown.

    Parameters
    ----------
    server_time_s : float
        The instant, on the server's clock.
    phase, time_s, duration_s, error : float
        As in a record; of a loop, phase and time stay within one cycle.
    version : int
    clamped, in_transition : bool
    ended : bool
        The motion is at its end.
    root : (3,) float32 or None
        None of weights.
    rotations : (J, 4) float32 or None
        Unit quaternions. None of weights.
    weights : (N,) float32 or None
        Of weights only.
    delay_s : float
        How much later than the earliest possible this is shown.
    beyond_s : float
        How far it lies past the last frame that came; 0 where frames are there.
    held : bool
        Whether it lies so far past it that the motion stands still.
    """

    server_time_s: float
    phase: float
    time_s: float
    duration_s: float
    error: float
    version: int
    clamped: bool
    in_transition: bool
    ended: bool
    root: F32 | None
    rotations: F32 | None
    weights: F32 | None
    delay_s: float
    beyond_s: float
    held: bool


class JitterBuffer:
    """Frames of one channel. One thread may push while another samples.

    Parameters
    ----------
    lateness : Lateness
        Of the stream: all its channels come in the same messages.
    interval_s : float
        Between two frames.
    delays : Delays
    """

    def __init__(self, lateness: Lateness, interval_s: float, delays: Delays | None = None) -> None:
        self.interval_s, self.looping = interval_s, False
        self.late, self.duplicates = 0, 0
        self._lateness, self._delays = lateness, delays or Delays()
        self._times: list[float] = []
        self._records: list[Record] = []
        self._lag_s: float | None = None  # what is shown at t was due at t - lag, on the server's clock
        self._sampled_s, self._shown_s = -math.inf, -math.inf
        self._anew = False
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._times)

    @property
    def last(self) -> Record | None:
        """The newest frame."""
        with self._lock:
            return self._records[-1] if self._records else None

    def push(self, due_s: float, record: Record) -> None:
        """Take a frame.

        Parameters
        ----------
        due_s : float
            When it was due, on the server's clock.
        record : Record
        """
        with self._lock:
            if self._anew:
                self._forget()
            at = bisect_right(self._times, due_s)
            if at and self._times[at - 1] == due_s:
                self.duplicates += 1
                return
            self.late += due_s < self._shown_s
            self._times.insert(at, due_s)
            self._records.insert(at, record)
            if len(self._times) > FRAMES_KEPT:
                del self._times[0], self._records[0]

    def restart(self) -> None:
        """Start anew with the next frame, which may be on another clock; until then show what there is."""
        with self._lock:
            self._anew = True

    def _forget(self) -> None:
        self._times.clear()
        self._records.clear()
        self._lag_s, self._sampled_s, self._shown_s, self._anew = None, -math.inf, -math.inf, False

    @property
    def delay_s(self) -> float:
        """The delay that what was observed asks for, within the bounds."""
        measured = self._lateness.measured()
        late_s = 0.0 if measured is None else measured[1]
        return min(max(self.interval_s + late_s, self._delays.least_s), self._delays.most_s)

    def sample(self, now_s: float) -> Sample | None:
        """The pose to show now.

        Parameters
        ----------
        now_s : float
            On the clock on which messages arrive. What is shown changes its pace only as this goes forward; to ask
            for an instant before the last one is allowed, and changes nothing.

        Returns
        -------
        Sample or None
            None before the first frame.
        """
        with self._lock:
            if not self._times:
                return None
            shown_s, delay_s = self._playhead(now_s)
            return self._between(shown_s, delay_s)

    def _playhead(self, now_s: float) -> tuple[float, float]:
        """The instant to show, on the server's clock, and the delay that it has."""
        measured = self._lateness.measured()
        if measured is None or self._anew:
            lag_s, ground_s = self._lag_s if self._lag_s is not None else now_s - self._times[0], 0.0
            return now_s - lag_s, lag_s - ground_s
        target_s = measured[0] + self.delay_s
        if self._lag_s is None or abs(target_s - self._lag_s) > SNAP_S:
            self._lag_s = target_s
        elif now_s > self._sampled_s:
            passed_s = now_s - self._sampled_s
            self._lag_s += min(max(target_s - self._lag_s, -FASTER * passed_s), SLOWER * passed_s)
        self._sampled_s = max(now_s, self._sampled_s)
        shown_s = now_s - self._lag_s
        self._shown_s = max(shown_s, self._shown_s)
        return shown_s, self._lag_s - measured[0]

    def _between(self, shown_s: float, delay_s: float) -> Sample:
        """The pose at an instant: between two frames, or past the last one."""
        times, records = self._times, self._records
        at = bisect_right(times, shown_s)
        if at == 0:
            return self._blended(records[0], records[0], 0.0, times[0], delay_s, 0.0)
        if at < len(times):
            share = (shown_s - times[at - 1]) / (times[at] - times[at - 1])
            return self._blended(records[at - 1], records[at], share, shown_s, delay_s, 0.0)
        beyond_s = shown_s - times[-1]
        step_s = times[-1] - times[-2] if len(times) > 1 else math.inf
        if step_s > LONGEST_STEP * self.interval_s or records[-1].flags & LAST:
            return self._blended(records[-1], records[-1], 1.0, shown_s, delay_s, beyond_s)
        share = 1.0 + min(beyond_s, self._delays.extrapolate_s) / step_s
        return self._blended(records[-2], records[-1], share, shown_s, delay_s, beyond_s)

    def _blended(self, a: Record, b: Record, share: float, shown_s: float, delay_s: float, beyond_s: float) -> Sample:
        """Two frames, blended; beyond the second where the share is above 1."""
        near = a if share < 0.5 else b
        phase, time_s = self._phase(a, b, share)
        error = near.error if math.isnan(a.error + b.error) or share > 1.0 else _line(a.error, b.error, share)
        root, rotations, weights = near.root, near.rotations, near.weights
        if a is not b:
            if a.root is not None and b.root is not None:
                root = (a.root + share * (b.root - a.root)).astype(np.float32)
            if a.rotations is not None and b.rotations is not None and a.rotations.shape == b.rotations.shape:
                rotations = quat.slerp(a.rotations, b.rotations, share).astype(np.float32)
            if a.weights is not None and b.weights is not None and a.weights.shape == b.weights.shape:
                weights = (a.weights + share * (b.weights - a.weights)).astype(np.float32)
        return Sample(
            shown_s,
            phase,
            time_s,
            _line(a.duration_s, b.duration_s, min(share, 1.0)),
            error,
            near.version,
            bool(near.flags & CLAMPED),
            bool(near.flags & IN_TRANSITION),
            bool(near.flags & LAST),
            root,
            rotations,
            weights,
            delay_s,
            beyond_s,
            beyond_s > self._delays.extrapolate_s,
        )

    def _phase(self, a: Record, b: Record, share: float) -> tuple[float, float]:
        """Phase and seconds, across the seam of a loop where that is the shorter way."""
        if not self.looping:
            phase, time_s = _line(a.phase, b.phase, share), _line(a.time_s, b.time_s, share)
            return min(max(phase, 0.0), 1.0), min(max(time_s, 0.0), max(a.duration_s, b.duration_s))
        turn = round(a.phase - b.phase)  # 1 forwards over the seam, -1 backwards
        phase = _line(a.phase, b.phase + turn, share)
        time_s = _line(a.time_s, b.time_s + turn * b.duration_s, share)
        return phase % 1.0, time_s % b.duration_s if b.duration_s > 0.0 else 0.0


def _line(a: float, b: float, share: float) -> float:
    return a + share * (b - a)
