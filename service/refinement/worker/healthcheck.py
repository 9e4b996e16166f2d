"""Whether the worker of this machine lives, for whoever starts it again.

``python -m service.refinement.worker.healthcheck [NAME]``

A worker holds the lock of its name for as long as it lives, and serves nothing that could be asked instead.
"""

from __future__ import annotations

import platform
import sys

from service.refinement.worker.locks import locks_of
from service.settings import Settings

__all__ = ["alive"]


def alive(database_url: str, executor_id: str) -> bool:
    """Whether a worker of that name holds its lock; also where the database cannot say."""
    locks = locks_of(database_url)
    try:
        with locks.tried(executor_id) as dead:
            return not dead
    finally:
        locks.close()


if __name__ == "__main__":
    sys.exit(not alive(Settings().database, sys.argv[1] if sys.argv[1:] else platform.node() or "worker"))
