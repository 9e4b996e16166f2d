"""Health check of the worker on this machine, for container orchestration.

``python -m service.refinement.worker.healthcheck [NAME]``

A worker holds the lock of its name as long as it runs; it has no HTTP endpoint.
"""

from __future__ import annotations

import platform
import sys

from service.refinement.worker.locks import locks_of
from service.settings import Settings

__all__ = ["alive"]


def alive(database_url: str, executor_id: str) -> bool:
    """Whether a worker of that name holds its lock."""
    locks = locks_of(database_url)
    try:
        with locks.try_lock(executor_id) as dead:
            return not dead
    finally:
        locks.close()


if __name__ == "__main__":
    sys.exit(not alive(Settings().database, sys.argv[1] if sys.argv[1:] else platform.node() or "worker"))
