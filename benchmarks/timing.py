"""Interleaved timing: on a shared machine only minima of many rounds, taken in turns, can be compared."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

__all__ = ["interleave", "machine"]


def interleave(tasks: dict[str, Callable[[], object]], *, rounds: int = 40) -> dict[str, float]:
    """Least seconds of each task over rounds in which every task runs once, in turns."""
    best = dict.fromkeys(tasks, float("inf"))
    for task in tasks.values():
        task()  # compile and warm up
    for _ in range(rounds):
        for name, task in tasks.items():
            started = time.perf_counter()
            task()
            best[name] = min(best[name], time.perf_counter() - started)
    return best


def machine() -> str:
    """One line that names the machine and the versions that matter."""
    import numba
    import numpy as np
    import scipy

    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"numpy {np.__version__}, scipy {scipy.__version__}, numba {numba.__version__}"
    )
