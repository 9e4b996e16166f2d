"""A refinement job: its steps, each of which can be lost and done again, and the order in which they follow.

begin → advance, repeatedly → weigh → publish → close. Steps hand each other names of blobs and numbers; arrays are in
the blobs. A step that is done twice gives the same.

The result is compared with the version that the job started from. It is activated only if that version still is
current when it is published; otherwise it is kept, so that a roll-back or another version is never undone.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from service.refinement.job_spec import Asked
from service.refinement.usage_counts import drawn, together
from service.refinement.worker.acceptance import held_out, judge
from service.refinement.worker.checkpoint import SETS, Course, go_on
from service.refinement.worker.scratch import Scratch
from service.store.records import ENDED, Job, JobEnded, StoreError, StoreUnavailable, UnknownVerb
from service.store.store import Store
from verbs.conventions import F64
from verbs.errors import VerbError
from verbs.io import artifact
from verbs.refine import with_basis
from verbs.verb import Verb

__all__ = ["STEP_S", "TRAFFIC_S", "Leaving", "Work", "transient"]

STEP_S = 2.0
"""Least time that a step advances for, seconds; it ends with the pseudo-example after that."""

TRAFFIC_S = 7 * 24 * 3600.0
"""Age of the oldest traffic that counts, seconds."""

DELETED = "not better: the verb was deleted meanwhile"

_STREAM = 2
"""Which random numbers of a seed search points are drawn from traffic by; see also ``judge``."""

State = dict[str, Any]
Step = Callable[..., State]

log = structlog.get_logger("adverb.worker")


class Leaving(BaseException):
    """A worker stops between two steps, and another goes on: no failure of the job, and no ``Exception`` either."""


def transient(err: BaseException) -> bool:
    """Whether a step that failed so is worth another try."""
    return isinstance(err, StoreUnavailable)


class Work:
    """The steps of jobs, on a store.

    Parameters
    ----------
    store : Store
    artifacts : str
        Where the store's artifacts lie; what jobs keep between steps lies below it.
    step : callable
        Called with a name, a function and its arguments: runs a step, or gives what it gave when it was finished.
    cache : Path, optional
        Local folder for what an object store keeps.
    step_s : float
        See :data:`STEP_S`.
    """

    def __init__(
        self, store: Store, artifacts: str, *, step: Step, cache: Path | None = None, step_s: float = STEP_S
    ) -> None:
        self.store, self.artifacts, self.cache, self.step_s = store, artifacts, cache, step_s
        self.leaving = threading.Event()
        self._step = step
        self._loaded = lru_cache(maxsize=4)(artifact.load)  # a blob's path names its bytes

    def run(self, job: str) -> State:
        """All steps of a job, in order; returns how it ended."""
        try:
            return self._run(job)
        except Exception as err:  # whatever it is, the job is over and its user reads why
            log.error("job failed", job=job, exc_info=err)
            return self._step("close", self.close, job, "failed", _problem(err))

    def _run(self, job: str) -> State:
        state = self._step("begin", self.begin, job)
        while not state["stopped"]:
            if self.leaving.is_set():
                raise Leaving
            state = self._step("advance", self.advance, job, state)
        if state["ended"]:
            return self._step("close", self.close, job, "", "")
        weighed = self._step("weigh", self.weigh, job, state)
        if weighed["better"] and self._step("publish", self.publish, job, weighed)["ended"]:
            return self._step("close", self.close, job, "", "")
        text = DELETED if weighed["better"] else weighed["text"]
        return self._step("close", self.close, job, "not_better", text)

    def begin(self, job: str) -> State:
        """Fix what the job goes by: the version and, where it was asked for, the traffic so far."""
        row, scratch = self.store.job(job), self._scratch(job)
        state: State = {"checkpoint": "", "kept": [], "cells": "", "spent_s": 0.0, "stopped": "", "ended": False}
        if row.state in ENDED:
            return state | {"stopped": row.state, "ended": True}
        verb, asked = self._verb(row.verb, row.version_before), _asked(row)
        if asked.weighted_by_traffic:
            cells = self._cells(row.verb)
            if len(drawn(verb, cells, np.random.default_rng(0), 1)):
                state["cells"] = scratch.put(json.dumps(cells).encode())
        course = Course.start(verb, len(self._sets(job, verb, asked, state)))
        name = scratch.put(course.to_bytes())
        self._tell(job, state="running", progress=_progress(course, asked, state))
        log.info("job begun", job=job, verb=row.verb, version=row.version_before)
        return state | {"checkpoint": name, "kept": [name]}

    def advance(self, job: str, state: State) -> State:
        """Refine for a while from the latest checkpoint on, and write the next."""
        row, began_s, scratch = self.store.job(job), time.monotonic(), self._scratch(job)
        if row.state in ENDED:
            return state | {"stopped": row.state, "ended": True}
        verb, asked = self._verb(row.verb, row.version_before), _asked(row)
        left_s = asked.budget_s - state["spent_s"]

        def enough() -> bool:
            taken_s = time.monotonic() - began_s
            return self.leaving.is_set() or taken_s >= min(self.step_s, left_s)

        sets = self._sets(job, verb, asked, state)
        course = go_on(verb, Course.of_bytes(scratch.get(state["checkpoint"])), asked.rules, sets, enough=enough)
        name = scratch.put(course.to_bytes())
        spent_s = round(state["spent_s"] + time.monotonic() - began_s, 3)
        stopped = course.stopped or ("budget spent" if spent_s >= asked.budget_s else "")
        kept = scratch.latest(state["kept"], name)
        state = state | {"checkpoint": name, "kept": kept, "spent_s": spent_s, "stopped": stopped}
        self._tell(job, progress=_progress(course, asked, state))
        log.info("step done", job=job, verb=row.verb, steps=course.steps, checkpoint=name[:12], stopped=stopped)
        return state

    def weigh(self, job: str, state: State) -> State:
        """Compare the result with the version that the job started from."""
        row, scratch = self.store.job(job), self._scratch(job)
        if row.verb not in self.store.current():
            return {"better": False, "text": DELETED}
        asked, now = _asked(row), self._verb(row.verb, row.version_before)
        course = Course.of_bytes(scratch.get(state["checkpoint"]))
        new = with_basis(now, course.basis, asked.rules, course.mark)
        cells = json.loads(scratch.get(state["cells"])) if state["cells"] else None
        if cells:
            made = {**new.provenance["refinement"], "weighted_by_traffic": True}
            new = replace(new, provenance={**new.provenance, "refinement": made})
        points = held_out(now, asked.seed, cells)
        verdict = judge(now, new, asked.method, points)
        figures = verdict.as_dict() | {"against": row.version_before}
        self._tell(job, progress=_progress(course, asked, state) | {"figures": figures})
        name = scratch.put_verb(new) if verdict.better else ""
        log.info("job weighed", job=job, verb=row.verb, against=row.version_before, better=verdict.better)
        return {"better": verdict.better, "text": verdict.text, "candidate": name, "figures": figures}

    def publish(self, job: str, weighed: State) -> State:
        """Publish the result and end the job, both or neither; ``ended`` is False where the verb was deleted."""
        row, name, against = self.store.job(job), weighed["candidate"], weighed["figures"]["against"]
        if row.state in ENDED:  # it was cancelled; or this step was done before, by whoever had the job then
            return {"ended": True}
        try:
            self.store.publish(
                row.verb, self._scratch(job).path(name), author=f"job {job}", reason=weighed["text"][:1_000],
                quality=weighed["figures"], parent=against, activate_if=against, ends=job,
            )  # fmt: skip
        except UnknownVerb:
            return {"ended": False}
        except JobEnded as err:
            log.info("job has ended", job=job, state=err.state)
        return {"ended": True}

    def close(self, job: str, state: str, detail: str) -> State:
        """Tell the user how it ended, and tidy up; an empty state stands for a job that has ended already."""
        if state:
            self._tell(job, state=state, detail=detail)
        self._scratch(job).clear()
        row = self.store.job(job)
        log.info("job closed", job=job, state=row.state, version=row.version_after)
        return {"state": row.state, "version": row.version_after}

    def _tell(self, job: str, **changes: Any) -> None:
        """Change the job's row, unless it was cancelled or given up meanwhile."""
        try:
            self.store.update_job(job, **changes)
        except JobEnded as err:
            log.info("job has ended", job=job, state=err.state)

    def _scratch(self, job: str) -> Scratch:
        return Scratch(self.artifacts, job, cache=self.cache)

    def _verb(self, name: str, number: int | None) -> Verb:
        assert number is not None  # jobs are made with it
        return self._loaded(self.store.path(self.store.version(name, number)))

    def _cells(self, verb: str) -> list[dict[str, Any]]:
        """Traffic of the last week, of all servers together."""
        now_s = time.time()
        return together(self.store.traffic(verb, not_before_s=now_s - TRAFFIC_S), now_s)

    def _sets(self, job: str, verb: Verb, asked: Asked, state: State) -> list[F64 | None]:
        """Sets of search points: what a refinement chooses by itself and, with traffic, points drawn from it."""
        if not state["cells"]:
            return [None]
        cells, rng = json.loads(self._scratch(job).get(state["cells"])), np.random.default_rng([asked.seed, _STREAM])
        return [None, drawn(verb, cells, rng, asked.rules.samples)]


def _problem(err: Exception) -> str:
    """What a user reads of a failure: the library's and the store's errors are meant for them, others are not."""
    if not isinstance(err, VerbError | StoreError):
        return f"internal error ({type(err).__name__}); the worker's log has the rest"
    text = str(getattr(err, "problem", err)).replace("\0", " ")  # without the path of a file
    return text.encode("utf-8", "replace").decode()[:1_000]


def _asked(row: Job) -> Asked:
    return Asked.of({name: value for name, value in row.request.items() if name != "author"})


def _progress(course: Course, asked: Asked, state: State) -> dict[str, Any]:
    """How far a job is, as JSON values; errors are shares of the diagonal."""
    curves = {name: [list(row) for row in curve] for name, curve in zip(SETS, course.curves, strict=False)}
    pseudo, mean, top = course.curves[0][-1] if course.curves[0] else (0, None, None)
    pseudo = max((curve[-1][0] for curve in course.curves if curve), default=pseudo)
    ratio = 1.0 if state["stopped"] else max(pseudo / max(asked.max_pseudo, 1), state["spent_s"] / asked.budget_s)
    return {
        "ratio": round(min(ratio, 1.0), 4),
        "pseudo": pseudo,
        "error_mean": mean,
        "error_max": top,
        "steps": course.steps,
        "spent_s": state["spent_s"],
        "stopped": state["stopped"],
        "note": "no traffic was recorded" if asked.weighted_by_traffic and not state["cells"] else "",
        "curve": curves["uniform"],
        "curve_traffic": curves.get("traffic", []),
    }
