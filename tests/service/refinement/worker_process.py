"""A worker for tests, with short steps, forked from a process that has loaded everything."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
import structlog

from service.refinement.worker import steps
from service.refinement.worker.acceptance import compare
from service.refinement.worker.checkpoint import Checkpoint, resume_refinement
from service.refinement.worker.main import run
from verbs import library
from verbs.domain import random_points
from verbs.refine import Rules, refine, with_basis

PAUSE_S = 0.06
"""Delay of every step, so that its worker can be killed; each step inserts one pseudo-example."""


def run_worker(database_url: str, artifacts: str, executor_id: str, log: str, errors: str) -> None:
    """Run jobs until SIGTERM; the log is a file with one JSON object per line."""
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_APPEND), sys.stderr.fileno())
    file = Path(log).open("a", buffering=1)  # noqa: SIM115 until the process ends
    structlog.configure(
        processors=[
            structlog.processors.TimeStamper(fmt=None),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.PrintLoggerFactory(file),
    )
    steps.resume_refinement = resume_slowly
    run(database_url, artifacts, executor_id=executor_id, poll_s=0.5, step_s=0.0, report=lambda text: None)


def resume_slowly(*arguments, **options) -> Checkpoint:
    """Resume from a checkpoint, after a delay."""
    time.sleep(PAUSE_S)
    return resume_refinement(*arguments, **options)


def warm() -> None:
    """Load the kernels that a job needs."""
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=1)
    *_, last = refine(verb, rules)
    new = with_basis(verb, last.basis, rules, last.mark)
    compare(verb, new, "hybrid", random_points(verb, np.random.default_rng(0), 10))


if __name__ == "__mp_main__" or "multiprocessing.forkserver" in sys.modules:
    warm()
