from __future__ import annotations

import hashlib
import signal
import time

import pytest

from service.store.store import STEPS
from tests.service.store.children import PROCESSES, open_once, publish_and_die, publish_many, start

BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}
HOURS_S = 3600.0


def test_two_processes_that_publish_one_name_get_all_numbers(location, tmp_path):
    barrier = PROCESSES.Barrier(2)
    children = [start(publish_many, location, tmp_path, name, 20, barrier) for name in ("left", "right")]
    for child in children:
        child.join(120)
        assert child.exitcode == 0
    store = location.open()
    versions = store.versions("reach")
    assert [version.number for version in versions] == list(range(1, 41))
    assert [event.number for event in store.history("reach")] == list(range(1, 41))
    assert store.current()["reach"].number == 40
    for version in versions:
        assert hashlib.sha256(store.path(version).read_bytes()).hexdigest() == version.sha256
    assert len(location.files()) == 40
    store.close()


def test_processes_may_open_a_new_store_at_once(location):
    barrier, results = PROCESSES.Barrier(4), PROCESSES.Queue()
    children = [start(open_once, location, barrier, results) for _ in range(4)]
    assert [results.get(timeout=120) for _ in children] == [{}] * 4
    for child in children:
        child.join(60)
        assert child.exitcode == 0


@pytest.mark.parametrize("step", STEPS)
def test_a_publisher_killed_at_any_step_leaves_no_half_version(location, artifact, tmp_path, step):
    store = location.open()
    first = store.publish("reach", artifact("one"), **BY_ADA)
    second = tmp_path / "second.verb"
    second.write_text("two" * 1000)
    child = start(publish_and_die, location, second, step)
    child.join(120)
    assert child.exitcode == -signal.SIGKILL
    assert store.current() == {"reach": first}
    assert store.versions("reach") == [first]
    assert [event.number for event in store.history("reach")] == [1]
    left = location.files() - {f"{first.sha256}.verb"}
    assert len(left) == (step != "write")
    assert store.collect(now_s=time.time()) == []  # a young file may belong to a running publisher
    assert store.collect(now_s=time.time() + 2 * HOURS_S) == sorted(left)
    assert location.files() == {f"{first.sha256}.verb"}
    assert store.publish("reach", second, **BY_ADA).number == 2
    assert store.path(store.current()["reach"]).read_bytes() == second.read_bytes()
    store.close()
