"""The jitter buffer: turns frames with irregular arrival times into poses at any display time.

A pose is displayed later than its frame was due: by the interval between two frames, so that there is a frame before
and after it, and by the 98 % quantile of lateness. The delay follows the measured lateness slowly, so that the change
of pace is not visible. Without new frames, the motion is extrapolated for a short time and then held.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from adverb_client import quat
from adverb_client.clock import Lateness
from adverb_client.records import CLAMPED, IN_TRANSITION, LAST
from adverb_client.wire import Record

__all__ = ["Delays", "JitterBuffer", "Sample"]

F32 = npt.NDArray[np.float32]

MAX_FRAMES = 128
SNAP_S = 0.5
"""The playhead jumps if its error is larger than this."""
SLOWER, FASTER = 0.20, 0.10
"""Limits by which display time may run slower or faster than real time while the delay changes, as fractions."""
MAX_STEP = 3.5
"""Two frames further apart than so many intervals give no velocity for extrapolation."""
GAP_DECAY = 0.9
"""Factor of the longest time between frames, per frame."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Bounds of a jitter buffer, seconds.

    Parameters
    ----------
    min_s, max_s : float
        Bounds of the delay.
    extrapolate_s : float
        Longest extrapolation past the last frame.
    """

    min_s: float = 0.0
    max_s: float = 0.25
    extrapolate_s: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A pose at the displayed instant.

    Parameters
    ----------
    server_time_s : float
        The displayed instant, on the server's clock.
    phase, time_s, duration_s, error : float
        As in a record; phase and time of a loop stay within one cycle.
    version : int
    clamped, in_transition : bool
    ended : bool
        Whether the motion is at its end.
    root : (3,) float32 or None
        None for ``weights``.
    rotations : (J, 4) float32 or None
        Unit quaternions. None for ``weights``.
    weights : (N,) float32 or None
        For ``weights`` only.
    delay_s : float
        Display delay, relative to the smallest transit.
    extrapolated_s : float
        Time past the last received frame; 0 between frames.
    held : bool
        Whether that time is longer than the extrapolation, so that the motion is held.
    support : float or None
        How well the examples support the pose, 0 to 1; None unless the channel requests it.
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
    extrapolated_s: float
    held: bool
    support: float | None = None


class JitterBuffer:
    """Frames of one channel; one thread may push while another samples.

    Parameters
    ----------
    lateness : Lateness
        Lateness of the stream's messages, which its channels share.
    interval_s : float
        Time between two frames.
    delays : Delays
    """

    def __init__(self, lateness: Lateness, interval_s: float, delays: Delays | None = None) -> None:
        self.interval_s, self.looping = interval_s, False
        self._gap_s = 0.0  # decaying maximum of the time between frames, where a byte budget leaves some out
        self.late, self.duplicates = 0, 0
        self._lateness, self._delays = lateness, delays or Delays()
        self._times: list[float] = []
        self._records: list[Record] = []
        self._lag_s: float | None = None  # at time t the frame due at t - lag is displayed
        self._sampled_s, self._shown_s = -math.inf, -math.inf
        self._restart_pending = False
        self._ending, self._end_phase = False, math.nan
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._times)

    @property
    def last(self) -> Record | None:
        """The newest frame."""
        with self._lock:
            return self._records[-1] if self._records else None

    def push(self, due_s: float, record: Record, *, irregular: bool = False) -> None:
        """Add a frame.

        Parameters
        ----------
        due_s : float
            Its due time on the server's clock.
        record : Record
        irregular : bool
            Whether a byte budget leaves frames out: the interval is then that of the frames that arrive.
        """
        with self._lock:
            if self._restart_pending:
                self._forget()
            at = bisect_right(self._times, due_s)
            if at and self._times[at - 1] == due_s:
                self.duplicates += 1
                return
            gap_s = due_s - self._times[-1] if self._times and at == len(self._times) else 0.0
            self._gap_s = max(gap_s, GAP_DECAY * self._gap_s) if irregular else 0.0
            self.late += due_s < self._shown_s
            self._times.insert(at, due_s)
            self._records.insert(at, self._marked(record))
            if len(self._times) > MAX_FRAMES:
                del self._times[0], self._records[0]

    def end(self) -> None:
        """Note that the motion ends with the next frame."""
        with self._lock:
            self._ending = True

    def _marked(self, record: Record) -> Record:
        """The record, with the flag ``last`` also where the motion rests at its end.

        The server sets the flag on one record, which may be lost; its message ``end`` is not.
        """
        if self._ending or record.flags & LAST:
            self._ending, self._end_phase = False, record.phase
        if record.phase != self._end_phase:
            self._end_phase = math.nan
        elif not record.flags & LAST:
            return replace(record, flags=record.flags | LAST)
        return record

    def restart(self) -> None:
        """Restart at the next frame, which may be on another clock; until then display the old frames."""
        with self._lock:
            self._restart_pending = True

    def _forget(self) -> None:
        self._gap_s = 0.0
        self._times.clear()
        self._records.clear()
        self._lag_s, self._sampled_s, self._shown_s, self._restart_pending = None, -math.inf, -math.inf, False
        self._end_phase = math.nan

    @property
    def delay_s(self) -> float:
        """The target delay: interval plus lateness, within the bounds."""
        measured = self._lateness.measured()
        late_s = 0.0 if measured is None else measured[1]
        return min(max(self._spacing_s + late_s, self._delays.min_s), self._delays.max_s)

    @property
    def _spacing_s(self) -> float:
        return max(self.interval_s, self._gap_s)

    def sample(self, now_s: float) -> Sample | None:
        """The pose to display at a time.

        Parameters
        ----------
        now_s : float
            On the clock of arrival times. The delay changes only as this goes forward; an earlier time than the last
            one is allowed and changes no state.

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
        """The instant to display, on the server's clock, and its delay."""
        measured = self._lateness.measured()
        if measured is None or self._restart_pending:
            lag_s = self._lag_s if self._lag_s is not None else now_s - self._times[0]
            return now_s - lag_s, self.delay_s  # the clocks are not compared yet
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
        """The pose at an instant: interpolated between two frames, or extrapolated past the last one."""
        times, records = self._times, self._records
        at = bisect_right(times, shown_s)
        if at == 0:
            return self._blended(records[0], records[0], 0.0, times[0], delay_s, 0.0)
        if at < len(times):
            share = (shown_s - times[at - 1]) / (times[at] - times[at - 1])
            return self._blended(records[at - 1], records[at], share, shown_s, delay_s, 0.0)
        extrapolated_s = shown_s - times[-1]
        step_s = times[-1] - times[-2] if len(times) > 1 else math.inf
        if step_s > MAX_STEP * self._spacing_s or records[-1].flags & LAST:
            return self._blended(records[-1], records[-1], 1.0, shown_s, delay_s, extrapolated_s)
        share = 1.0 + min(extrapolated_s, self._delays.extrapolate_s) / step_s
        return self._blended(records[-2], records[-1], share, shown_s, delay_s, extrapolated_s)

    def _blended(
        self, a: Record, b: Record, share: float, shown_s: float, delay_s: float, extrapolated_s: float
    ) -> Sample:
        """Interpolate two frames; a share above 1 extrapolates past the second."""
        near = a if share < 0.5 else b
        phase, time_s = self._phase(a, b, share)
        error = near.error if math.isnan(a.error + b.error) or share > 1.0 else _lerp(a.error, b.error, share)
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
            _lerp(a.duration_s, b.duration_s, min(share, 1.0)),
            error,
            near.version,
            bool(near.flags & CLAMPED),
            bool(near.flags & IN_TRANSITION),
            bool(near.flags & LAST),
            root,
            rotations,
            weights,
            delay_s,
            extrapolated_s,
            extrapolated_s > self._delays.extrapolate_s,
            near.support,
        )

    def _phase(self, a: Record, b: Record, share: float) -> tuple[float, float]:
        """Phase and seconds, across the end of a loop where that is shorter."""
        if not self.looping:
            phase, time_s = _lerp(a.phase, b.phase, share), _lerp(a.time_s, b.time_s, share)
            return min(max(phase, 0.0), 1.0), min(max(time_s, 0.0), max(a.duration_s, b.duration_s))
        wrap = round(a.phase - b.phase)  # 1 across the end forwards, -1 backwards
        phase = _lerp(a.phase, b.phase + wrap, share)
        time_s = _lerp(a.time_s, b.time_s + wrap * b.duration_s, share)
        return phase % 1.0, time_s % b.duration_s if b.duration_s > 0.0 else 0.0


def _lerp(a: float, b: float, share: float) -> float:
    return a + share * (b - a)
