"""Bounds of the work that one input causes: processor time, and memory in addition to what the process has."""

from __future__ import annotations

import mmap
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

CPU_S = 1.0
"""Processor time of one input, seconds; fuzzing measures it with instrumented code, which is several times slower."""

MEMORY_BYTES = 256 * 1024**2
"""Memory that one input may map in addition."""

MAX_INPUT_BYTES = 64 * 1024
"""Longest input for which the bounds are stated."""

_STUCK_S = 10.0
_STATM = Path("/proc/self/statm")


class TooSlow(Exception):
    """An input takes more processor time than :data:`CPU_S`."""


def run(function: Callable[[bytes], None], data: bytes) -> None:
    """Run a target on one input; raises :class:`TooSlow`, ``MemoryError``, or what the target raises."""
    with _limited_memory(), _ended_when_stuck():
        started_s = time.process_time()
        function(data)
        used_s = time.process_time() - started_s
    if used_s > CPU_S:
        raise TooSlow(f"{used_s:.2f} s of processor time")


@contextmanager
def _limited_memory() -> Iterator[None]:
    """Limit the address space of this process; only Linux states how much it has now."""
    if not _STATM.exists():
        yield
        return
    mapped = int(_STATM.read_bytes().split(None, 1)[0]) * mmap.PAGESIZE
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextmanager
def _ended_when_stuck() -> Iterator[None]:
    """Raise :class:`TooSlow` in the running code when it does not end by itself."""

    def stop(*_: object) -> None:
        raise TooSlow(f"more than {_STUCK_S:g} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, _STUCK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
