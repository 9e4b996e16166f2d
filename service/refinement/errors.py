"""Errors of refinement jobs; errors of the store pass through unchanged.

::

    JobError
    ├── AlreadyRunning    a job for this verb is queued or running (verb, job)
    └── ExecutorInUse     another worker uses this executor id (executor_id)
"""

from __future__ import annotations

__all__ = ["AlreadyRunning", "ExecutorInUse", "JobError"]


class JobError(Exception):
    """Root of the errors of refinement jobs."""


class AlreadyRunning(JobError):
    """A job for this verb is queued or running; ``job`` is its id."""

    def __init__(self, verb: str, job: str) -> None:
        self.verb, self.job = verb, job
        super().__init__(f"'{verb}' is being refined already, by job '{job}'; wait for that one, or cancel it")


class ExecutorInUse(JobError):
    """Another live worker uses this ``executor_id``."""

    def __init__(self, executor_id: str) -> None:
        self.executor_id = executor_id
        super().__init__(f"another worker runs as '{executor_id}'; stop it, or choose another executor id")
