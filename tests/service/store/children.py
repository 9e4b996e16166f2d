"""Processes that use a store during a test, forked from a server that has imported it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from service.store.store import Store
from tests.service.store.conftest import StoreLocation

PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["service.store.store", "psycopg", "tests.service.store.conftest"])


def start(work: Any, *arguments: Any) -> BaseProcess:
    child = PROCESSES.Process(target=work, args=arguments, daemon=True)
    child.start()
    return child


def publish_many(location: StoreLocation, folder: Path, name: str, count: int, barrier: Any) -> None:
    """Publish different artifacts as fast as possible, once all processes are ready."""
    store = location.open(timeout_s=30.0)
    file = folder / f"{name}.verb"
    barrier.wait(120)
    for k in range(count):
        file.write_text(f"{name} {k}")
        store.publish("reach", file, author=name, reason="race", quality={})
    store.close()


def publish_and_die(location: StoreLocation, file: Path, at: str) -> None:
    """Publish, and be killed before a step."""

    def die(step: str) -> None:
        if step == at:
            os.kill(os.getpid(), signal.SIGKILL)

    location.open().publish("reach", file, author="child", reason="dies", quality={}, at=die)


def publish_on_signal(location: StoreLocation, file: Path, pipe: Any, times: Any) -> None:
    """Publish at each message; send the time after it."""
    store = location.open()
    pipe.send("ready")
    while pipe.recv():
        file.write_text(str(time.monotonic()))
        version = store.publish("reach", file, author="child", reason="news", quality={})
        times.send((version.number, time.monotonic()))
    store.close()


def open_once(location: StoreLocation, barrier: Any, results: Any) -> None:
    """Open a new store at the same time as other processes."""
    barrier.wait(120)
    store: Store = location.open(timeout_s=30.0)
    results.put(store.current())
    store.close()
