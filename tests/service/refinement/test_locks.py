from __future__ import annotations

import pytest

from service.refinement.errors import ExecutorInUse
from service.refinement.worker.locks import locks_of
from tests.service.refinement.conftest import database, until
from verbs.errors import OutOfRange


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path) -> str:
    sqlite = request.param == "sqlite"
    return f"sqlite:///{tmp_path}/state.db" if sqlite else database(request.getfixturevalue("postgres"))


def test_lock_of_a_live_worker_cannot_be_taken(url):
    mine, other = locks_of(url), locks_of(url)
    lock = mine.acquire("worker-1")
    assert lock.ensure()
    assert other.acquire("worker-1") is None
    with other.try_lock("worker-1") as dead, other.try_lock("worker-2") as never_lived:
        assert (dead, never_lived) == (False, True)
    lock.release()
    until(lambda: taken(other, "worker-1", but=mine))  # PostgreSQL notices a closed connection a little later
    again = until(lambda: mine.acquire("worker-1"))
    again.release()
    mine.close()
    other.close()


def taken(locks, executor_id, *, but) -> bool:
    """Whether ``locks`` takes a lock, while ``but`` cannot."""
    with locks.try_lock(executor_id) as dead:
        return dead and but.acquire(executor_id) is None


def test_lost_session_is_reported_once_and_the_lock_taken_again(postgres):
    locks = locks_of(database(postgres))
    lock = locks.acquire("worker-1")
    postgres.stop()
    postgres.start()
    assert not lock.ensure()
    assert lock.ensure()
    with locks.try_lock("worker-1") as dead:
        assert not dead
    lock.release()
    locks.close()


@pytest.mark.parametrize("name", ["", "../x", "a b", "x" * 64, ".hidden"])
def test_executor_ids_are_names(url, name):
    locks = locks_of(url)
    with pytest.raises(OutOfRange, match="executor id"):
        locks.acquire(name)


def test_error_names_the_executor():
    assert "'worker-1'" in str(ExecutorInUse("worker-1"))
