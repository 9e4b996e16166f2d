"""Prometheus metrics: declarations with help and unit, and the methods that update them.

Labels are bounded: routes of the app or ``unmatched``, served verbs or ``none``, methods of the library or ``none``.
Names from clients never become labels.

With several server processes each writes its values to files of the folder in ``PROMETHEUS_MULTIPROC_DIR``, and any of
them reports the total; ``multiprocess_mode`` of a gauge defines how values are combined. See
:mod:`service.run.supervisor`.
"""

from __future__ import annotations

import math
import os
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from pathlib import Path

import anyio
import numpy as np
import numpy.typing as npt
import prometheus_client
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector

from service.catalog.catalog import Catalog, Entry
from verbs.conventions import F64
from verbs.runtime.evaluate import Blend

__all__ = ["UNMATCHED", "Metrics"]

UNMATCHED = "unmatched"
"""Label of a request that no route matches."""

LATENESS_INTERVAL_S = 0.25
"""Interval of event loop timers whose delay is measured, seconds."""

_SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.1, 0.5, 2.5)
_METERS = (1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0)
_LATENESS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.1, 1.0)

_STATS = {"examples_max": "error_examples_max_m", "mean": "error_mean_m", "max": "error_max_m"}
"""Label ``stat`` of the verbs' measured error, and where a verb's quality holds it."""

prometheus_client.disable_created_metrics()  # type: ignore[no-untyped-call]  # they add a series per histogram


class Metrics:
    """Metrics of one app, in a registry of its own."""

    def __init__(self) -> None:
        own = self.registry = CollectorRegistry()
        self._declare_requests(own)
        self._declare_verbs(own)
        self._declare_streams(own)
        self._cached: dict[tuple[str, str, str], Histogram] = {}
        self._requests_cached: dict[tuple[str, str, int], Counter] = {}
        self._poses_cached: dict[tuple[str, int, str], tuple[Histogram, Counter, Counter]] = {}
        self._exported = own
        if folder := os.environ.get("PROMETHEUS_MULTIPROC_DIR"):
            self._exported = CollectorRegistry()
            MultiProcessCollector(self._exported, folder)  # type: ignore[no-untyped-call]
            self._exported.register(_Processes(Path(folder)))
        else:
            prometheus_client.ProcessCollector(registry=own)
        prometheus_client.PlatformCollector(registry=self._exported)
        self._refinements = _Refinements()
        self._exported.register(self._refinements)
        self._database = _Database()
        self._exported.register(self._database)

    def _declare_requests(self, own: CollectorRegistry) -> None:
        self._duration = Histogram(
            "adverb_request_duration_seconds",
            "Time from the request head to the last byte of the response, seconds.",
            ("route", "verb", "method"),
            buckets=_SECONDS,
            registry=own,
        )
        self._requests = Counter(
            "adverb_requests_total", "Completed requests.", ("route", "http_method", "status"), registry=own
        )
        self._lateness = Histogram(
            "adverb_event_loop_lateness_seconds",
            "Delay of event loop timers, seconds; every request waits as long when the loop is blocked.",
            buckets=_LATENESS,
            registry=own,
        )

    def _declare_verbs(self, own: CollectorRegistry) -> None:
        self._error = Histogram(
            "adverb_pose_error_meters",
            "Distance between the goal and the measured result of poses, metres (metres per second for verbs that are "
            "measured by velocity).",
            ("verb", "version", "method"),
            buckets=_METERS,
            registry=own,
        )
        self._poses = Counter("adverb_poses_total", "Evaluated poses.", ("verb", "method"), registry=own)
        self._clamped = Counter(
            "adverb_clamped_total",
            "Poses whose adverbs were clamped to the domain.",
            ("verb",),
            registry=own,
        )
        self._version = Gauge(
            "adverb_verb_version",
            "Current version of the verb.",
            ("verb",),
            registry=own,
            multiprocess_mode="livemax",
        )
        self._verb_error = Gauge(
            "adverb_verb_error_meters",
            "Error measured when the verb was built, metres (or metres per second).",
            ("verb", "stat"),
            registry=own,
            multiprocess_mode="livemostrecent",
        )
        self._skipped = Gauge(
            "adverb_verb_files_skipped",
            "Files of the data folder that cannot be loaded.",
            registry=own,
            multiprocess_mode="livemax",
        )

    def _declare_streams(self, own: CollectorRegistry) -> None:
        self._late = Histogram(
            "adverb_stream_lateness_seconds",
            "Delay from the due time of a pose message to its write to the socket, seconds.",
            buckets=_LATENESS,
            registry=own,
        )
        self._frames = Counter("adverb_stream_frames_total", "Pose messages sent.", registry=own)
        self._dropped = Counter(
            "adverb_stream_frames_dropped_total",
            "Pose messages that were due but not sent, because the client or the server was too slow.",
            registry=own,
        )
        self._streams = Gauge("adverb_streams", "Connected streams.", registry=own, multiprocess_mode="livesum")
        self._channels = Gauge(
            "adverb_channels", "Open channels (characters) of all streams.", registry=own, multiprocess_mode="livesum"
        )

        self._closes = Counter(
            "adverb_stream_closes_total",
            "Streams that the server closed or refused, by close code: 1012 it stops, 4008 the client does not read, "
            "4009 taken over, 4029 too many, 4401 the key is not valid any more.",
            ("code",),
            registry=own,
        )

    def text(self) -> bytes:
        """All metrics of all processes in the Prometheus text format; takes some milliseconds."""
        return prometheus_client.generate_latest(self._exported)

    def count_request(self, route: str, http_method: str, status: int) -> None:
        """Count a completed request."""
        key = (route, http_method, status)
        child = self._requests_cached.get(key)
        if child is None:
            child = self._requests_cached[key] = self._requests.labels(route, http_method, str(status))
        child.inc()

    def observe_request(self, route: str, verb: str, method: str, seconds: float) -> None:
        """Observe the duration of a request."""
        key = (route, verb, method)
        child = self._cached.get(key)
        if child is None:
            child = self._cached[key] = self._duration.labels(*key)
        child.observe(seconds)

    def count_poses(self, entry: Entry, blend: Blend, poses: int) -> None:
        """Count evaluated poses and observe their errors; a sequence at constant adverbs has a single blend."""
        self.count_frames(entry, blend.method, blend.error, blend.clamped, poses)

    def count_frames(self, entry: Entry, method: str, errors: F64, clamped: npt.NDArray[np.bool_], poses: int) -> None:
        """Count poses, with the errors (B,) of their blends and whether these were clamped (B,)."""
        key = (entry.verb.name, entry.version, method)
        children = self._poses_cached.get(key)
        if children is None:
            name, version, method = key
            children = self._poses_cached[key] = (
                self._error.labels(name, str(version), method),
                self._poses.labels(name, method),
                self._clamped.labels(name),
            )
        error, count, outside = children
        count.inc(poses)
        if len(errors) == 1:
            value = float(errors[0])
            if not math.isnan(value):  # NaN where nothing can be measured
                error.observe(value)
            if clamped[0]:
                outside.inc()
            return
        _observe_many(error, errors[np.isfinite(errors)])
        outside.inc(int(np.count_nonzero(clamped)))

    def set_verbs(self, catalog: Catalog) -> None:
        """Set the versions and errors of the served verbs."""
        self._skipped.set(len(catalog.skipped))
        for name, entry in catalog.entries.items():
            self._version.labels(name).set(entry.version)
            quality = entry.verb.quality
            figures = {**quality, **quality.get("methods", {}).get(quality.get("method"), {})}
            for stat, key in _STATS.items():
                value = figures.get(key)
                if isinstance(value, int | float):
                    self._verb_error.labels(name, stat).set(value)

    def count_messages(self, sent: int, dropped: int, late_s: float) -> None:
        """Count the pose messages of one tick, and observe the delay of its last one."""
        if dropped:
            self._dropped.inc(dropped)
        if sent:
            self._frames.inc(sent)
            self._late._buckets[bisect_left(self._late._upper_bounds, late_s)].inc(sent)
            self._late._sum.inc(sent * late_s)

    def count_skipped(self, messages: int) -> None:
        """Count pose messages that were skipped because the server was too slow."""
        self._dropped.inc(messages)

    def count_close(self, code: int) -> None:
        """Count a stream that the server closed or refused."""
        self._closes.labels(str(code)).inc()

    def set_streams(self, streams: int, channels: int) -> None:
        """Set the number of streams and of characters."""
        self._streams.set(streams)
        self._channels.set(channels)

    def set_refinements(self, ended: Mapping[tuple[str, str], int], running: Mapping[str, float]) -> None:
        """Set the number of ended refinements by verb and outcome, and the progress of running ones by verb."""
        self._refinements.ended, self._refinements.running = ended, running

    def set_database(self, available: bool | None) -> None:
        """Set whether the database answered at the last attempt; None for a server without one."""
        self._database.available = available

    async def measure_lateness(self) -> None:
        """Observe the delay of event loop timers, until cancelled."""
        while True:
            due = anyio.current_time() + LATENESS_INTERVAL_S
            await anyio.sleep_until(due)
            self._lateness.observe(max(0.0, anyio.current_time() - due))


class _Refinements(Collector):
    """Refinements in the store: every process and server reports the same values, so they are not added up."""

    def __init__(self) -> None:
        self.ended: Mapping[tuple[str, str], int] = {}
        self.running: Mapping[str, float] = {}

    def collect(self) -> Iterable[Metric]:
        """A counter and a gauge."""
        ended = CounterMetricFamily("adverb_refinements", "Ended refinements in the store.", labels=("verb", "outcome"))
        for labels, count in self.ended.items():
            ended.add_metric(labels, count)
        running = GaugeMetricFamily(
            "adverb_refinement_progress_ratio", "Progress of the running refinement, 0 to 1.", labels=("verb",)
        )
        for verb, ratio in self.running.items():
            running.add_metric((verb,), ratio)
        return ended, running


class _Database(Collector):
    """Whether the database can be reached, as the process knows that answers."""

    def __init__(self) -> None:
        self.available: bool | None = None

    def collect(self) -> Iterable[Metric]:
        """A gauge, where there is a database."""
        if self.available is not None:
            yield GaugeMetricFamily(
                "adverb_database_available",
                "Whether the database answered at the last attempt: 1 or 0.",
                value=float(self.available),
            )


class _Processes(Collector):
    """Memory, processor time and open files of each server process, with the label ``process``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def collect(self) -> Iterable[Metric]:
        """Values from ``/proc`` for the processes whose ids are in the ``*.pid`` files of the folder."""
        families: dict[str, Metric] = {}
        for file in sorted(self._folder.glob("*.pid")):
            try:
                pid = file.read_text(encoding="ascii")
            except FileNotFoundError:
                continue  # the process has just ended
            for found in prometheus_client.ProcessCollector(pid=lambda pid=pid: pid, registry=None).collect():  # type: ignore[misc]
                family = families.setdefault(found.name, Metric(found.name, found.documentation, found.type))
                for sample in found.samples:
                    family.add_sample(sample.name, {"process": file.stem}, sample.value)
        return families.values()


def _observe_many(histogram: Histogram, values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    """Observe many values at once.

    A thousand calls of ``observe`` take a millisecond. prometheus_client has no batch call, so this increments the
    private buckets of the histogram, as ``observe`` does; a test compares the two.
    """
    if not len(values):
        return
    buckets = np.searchsorted(histogram._upper_bounds, values)
    for bucket, count in enumerate(np.bincount(buckets).tolist()):
        if count:
            histogram._buckets[bucket].inc(count)
    histogram._sum.inc(float(values.sum()))
