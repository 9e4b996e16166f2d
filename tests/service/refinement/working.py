"""A worker for tests, with short steps, in a process that is forked from one which has loaded everything."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
import structlog

from service.refinement.worker import steps
from service.refinement.worker.acceptance import judge
from service.refinement.worker.checkpoint import Course, go_on
from service.refinement.worker.main import run
from verbs import library
from verbs.domain import random_points
from verbs.refine import Rules, refine, with_basis

PAUSE_S = 0.06
"""What every step takes longer, so that there is time to kill its worker; each inserts one pseudo-example."""


def work(database_url: str, artifacts: str, executor_id: str, log: str, errors: str) -> None:
    """Work until told to stop; what is logged goes into a file, one JSON object a line."""
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
    steps.go_on = slowly
    run(database_url, artifacts, executor_id=executor_id, poll_s=0.5, step_s=0.0, say=lambda text: None)


def slowly(*arguments, **options) -> Course:
    """Go on from a course, after a pause."""
    time.sleep(PAUSE_S)
    return go_on(*arguments, **options)


def warm() -> None:
    """Load every kernel that a job needs."""
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=1)
    *_, last = refine(verb, rules)
    new = with_basis(verb, last.basis, rules, last.mark)
    judge(verb, new, "hybrid", random_points(verb, np.random.default_rng(0), 10))


if __name__ == "__mp_main__" or "multiprocessing.forkserver" in sys.modules:
    warm()
