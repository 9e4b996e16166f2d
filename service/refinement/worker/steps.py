"""Steps of a refinement job; each is idempotent, and can be repeated by another worker.

begin → advance, repeatedly → compare → publish → close. Steps pass numbers and names of blobs to each other; arrays are
in the blobs.

The result is compared with the version that the job started from. It is activated only if that version is still current
when it is published; otherwise it is kept, so that a roll-back or another version is never undone.
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

from service.refinement.job_spec import RefinementSpec
from service.refinement.usage_cells import merge_cells, sample_cells
from service.refinement.worker.acceptance import Comparison, compare, held_out
from service.refinement.worker.checkpoint import SETS, Checkpoint, resume_refinement
from service.refinement.worker.quality_checkpoint import QualityCheckpoint, resume_quality
from service.refinement.worker.scratch import Scratch
from service.store.records import ENDED, Job, JobEnded, StoreError, StoreUnavailable, UnknownVerb
from service.store.store import Store
from verbs import refine_quality
from verbs.conventions import F64
from verbs.errors import VerbError
from verbs.io import artifact
from verbs.refine import with_basis
from verbs.verb import Verb

__all__ = ["STEP_S", "USAGE_S", "JobSteps", "WorkerStopping", "transient"]

STEP_S = 2.0
"""Shortest duration of a step, seconds; it ends with the next pseudo-example, or attempt."""

USAGE_S = 7 * 24 * 3600.0
"""Age of the oldest usage that counts, seconds."""

DELETED = "not better: the verb was deleted meanwhile"

_STREAM = 2
"""Random stream of search points sampled from usage; see also ``acceptance``."""

State = dict[str, Any]
Step = Callable[..., State]
AnyCheckpoint = Checkpoint | QualityCheckpoint

log = structlog.get_logger("adverb.worker")


class WorkerStopping(BaseException):
    """The worker stops between two steps and another resumes the job; no ``Exception``, as the job has not failed."""


def transient(err: BaseException) -> bool:
    """Whether a step that failed with this error may be retried."""
    return isinstance(err, StoreUnavailable)


class JobSteps:
    """The steps of refinement jobs on a store.

    Parameters
    ----------
    store : Store
    artifacts : str
        Address of the store's artifacts; blobs of jobs are stored below it.
    step : callable
        Called with a name, a function and its arguments: runs a step, or returns the result of a finished one.
    cache : Path, optional
        Local folder for copies of an object store's blobs.
    step_s : float
        See :data:`STEP_S`.
    """

    def __init__(
        self, store: Store, artifacts: str, *, step: Step, cache: Path | None = None, step_s: float = STEP_S
    ) -> None:
        self.store, self.artifacts, self.cache, self.step_s = store, artifacts, cache, step_s
        self.stopping = threading.Event()
        self.running: set[str] = set()  # jobs that this process runs
        self._step = step
        self._loaded = lru_cache(maxsize=4)(artifact.load)  # the path of a blob is unique to its bytes

    def run(self, job: str) -> State:
        """Run all steps of a job in order; returns its final state."""
        self.running.add(job)
        try:
            return self._run(job)
        except Exception as err:  # any failure ends the job, with its reason in the detail
            log.error("job failed", job=job, exc_info=err)
            return self._step("close", self.close, job, "failed", _problem(err))
        finally:
            self.running.discard(job)

    def _run(self, job: str) -> State:
        state = self._step("begin", self.begin, job)
        while not state["stopped"]:
            if self.stopping.is_set():
                raise WorkerStopping
            state = self._step("advance", self.advance, job, state)
        if state["ended"]:
            return self._step("close", self.close, job, "", "")
        compared = self._step("compare", self.compare, job, state)
        if compared["better"] and self._step("publish", self.publish, job, compared)["ended"]:
            return self._step("close", self.close, job, "", "")
        text = DELETED if compared["better"] else compared["text"]
        return self._step("close", self.close, job, "not_better", text)

    def begin(self, job: str) -> State:
        """Store the inputs of the job: the first checkpoint and, if requested, the usage so far."""
        row, scratch = self.store.job(job), self._scratch(job)
        state: State = {"checkpoint": "", "kept": [], "cells": "", "spent_s": 0.0, "stopped": "", "ended": False}
        if row.state in ENDED:
            return state | {"stopped": row.state, "ended": True}
        verb, spec = self._verb(row.verb, row.version_before), _spec(row)
        if spec.weighted_by_traffic:
            cells = self._cells(row.verb)
            if len(sample_cells(verb, cells, np.random.default_rng(0), 1)):
                state["cells"] = scratch.put(json.dumps(cells).encode())
        checkpoint: AnyCheckpoint
        if spec.aim == "quality":
            refine_quality.check(verb)
            checkpoint = QualityCheckpoint.start(verb)
        else:
            checkpoint = Checkpoint.start(verb, len(self._sets(job, verb, spec, state)))
        name = scratch.put(checkpoint.to_bytes())
        self._update(job, state="running", progress=_progress(checkpoint, spec, state))
        log.info("job begun", job=job, verb=row.verb, version=row.version_before)
        return state | {"checkpoint": name, "kept": [name]}

    def advance(self, job: str, state: State) -> State:
        """Refine from the latest checkpoint, and store the next one."""
        row, began_s, scratch = self.store.job(job), time.monotonic(), self._scratch(job)
        if row.state in ENDED:
            return state | {"stopped": row.state, "ended": True}
        verb, spec = self._verb(row.verb, row.version_before), _spec(row)
        left_s = spec.budget_s - state["spent_s"]

        def should_stop() -> bool:
            elapsed_s = time.monotonic() - began_s
            return self.stopping.is_set() or elapsed_s >= min(self.step_s, left_s)

        before = _checkpoint(scratch.get(state["checkpoint"]), spec)
        if isinstance(before, QualityCheckpoint):
            checkpoint: AnyCheckpoint = resume_quality(verb, before, spec.quality_rules, should_stop=should_stop)
        else:
            sets = self._sets(job, verb, spec, state)
            checkpoint = resume_refinement(verb, before, spec.rules, sets, should_stop=should_stop)
        name = scratch.put(checkpoint.to_bytes())
        spent_s = round(state["spent_s"] + time.monotonic() - began_s, 3)
        stopped = checkpoint.stopped or ("budget spent" if spent_s >= spec.budget_s else "")
        kept = scratch.latest(state["kept"], name)
        state = state | {"checkpoint": name, "kept": kept, "spent_s": spent_s, "stopped": stopped}
        self._update(job, progress=_progress(checkpoint, spec, state))
        log.info("step done", job=job, verb=row.verb, steps=checkpoint.steps, checkpoint=name[:12], stopped=stopped)
        return state

    def compare(self, job: str, state: State) -> State:
        """Compare the result with the version that the job started from."""
        row, scratch = self.store.job(job), self._scratch(job)
        if row.verb not in self.store.current():
            return {"better": False, "text": DELETED}
        spec, current = _spec(row), self._verb(row.verb, row.version_before)
        checkpoint = _checkpoint(scratch.get(state["checkpoint"]), spec)
        if isinstance(checkpoint, QualityCheckpoint):
            new = refine_quality.with_basis(current, checkpoint.basis, spec.quality_rules, checkpoint.mark)
            result: Comparison | refine_quality.Comparison = refine_quality.compare(current, new, spec.seed)
        else:
            cells = json.loads(scratch.get(state["cells"])) if state["cells"] else None
            new = _refined(current, checkpoint, spec, weighted=bool(cells))
            result = compare(current, new, spec.method, held_out(current, spec.seed, cells))
        figures = result.to_json() | {"against": row.version_before}
        self._update(job, progress=_progress(checkpoint, spec, state) | {"figures": figures})
        name = scratch.put_verb(new) if result.better else ""
        log.info("job compared", job=job, verb=row.verb, against=row.version_before, better=result.better)
        return {"better": result.better, "text": result.text, "candidate": name, "figures": figures}

    def publish(self, job: str, compared: State) -> State:
        """Publish the result and end the job, both or neither; ``ended`` is False where the verb was deleted."""
        row, name, against = self.store.job(job), compared["candidate"], compared["figures"]["against"]
        if row.state in ENDED:  # cancelled, or published by an earlier run of this step
            return {"ended": True}
        try:
            self.store.publish(
                row.verb, self._scratch(job).path(name), author=f"job {job}", reason=compared["text"][:1_000],
                quality=compared["figures"], parent=against, activate_if=against, ends=job,
            )  # fmt: skip
        except UnknownVerb:
            return {"ended": False}
        except JobEnded as err:
            log.info("job has ended", job=job, state=err.state)
        return {"ended": True}

    def close(self, job: str, state: str, detail: str) -> State:
        """Store the final state and remove the blobs; the state is empty if the job has ended already."""
        if state:
            self._update(job, state=state, detail=detail)
        self._scratch(job).clear()
        row = self.store.job(job)
        log.info("job closed", job=job, state=row.state, version=row.version_after)
        return {"state": row.state, "version": row.version_after}

    def _update(self, job: str, **changes: Any) -> None:
        """Update the job's row, unless the job has ended."""
        try:
            self.store.update_job(job, **changes)
        except JobEnded as err:
            log.info("job has ended", job=job, state=err.state)

    def _scratch(self, job: str) -> Scratch:
        return Scratch(self.artifacts, job, cache=self.cache)

    def _verb(self, name: str, number: int | None) -> Verb:
        assert number is not None  # jobs are created with it
        return self._loaded(self.store.path(self.store.version(name, number)))

    def _cells(self, verb: str) -> list[dict[str, Any]]:
        """Usage cells of the last week, of all servers."""
        now_s = time.time()
        return merge_cells(self.store.usage(verb, not_before_s=now_s - USAGE_S), now_s)

    def _sets(self, job: str, verb: Verb, spec: RefinementSpec, state: State) -> list[F64 | None]:
        """Sets of search points: those that the refinement chooses itself and, with usage, points sampled from it."""
        if not state["cells"]:
            return [None]
        cells, rng = json.loads(self._scratch(job).get(state["cells"])), np.random.default_rng([spec.seed, _STREAM])
        return [None, sample_cells(verb, cells, rng, spec.rules.samples)]


def _checkpoint(data: bytes, spec: RefinementSpec) -> AnyCheckpoint:
    return QualityCheckpoint.from_bytes(data) if spec.aim == "quality" else Checkpoint.from_bytes(data)


def _refined(verb: Verb, checkpoint: Checkpoint, spec: RefinementSpec, *, weighted: bool) -> Verb:
    """The verb with the basis of a refinement for error."""
    new = with_basis(verb, checkpoint.basis, spec.rules, checkpoint.mark)
    if not weighted:
        return new
    made = {**new.provenance["refinement"], "weighted_by_traffic": True}
    return replace(new, provenance={**new.provenance, "refinement": made})


def _problem(err: Exception) -> str:
    """Detail of a failed job; only errors of the library and the store are shown to users."""
    if not isinstance(err, VerbError | StoreError):
        return f"internal error ({type(err).__name__}); see the worker's log"
    text = str(getattr(err, "problem", err)).replace("\0", " ")  # without the path of a file
    return text.encode("utf-8", "replace").decode()[:1_000]


def _spec(row: Job) -> RefinementSpec:
    return RefinementSpec.from_json({name: value for name, value in row.request.items() if name != "author"})


def _progress(checkpoint: AnyCheckpoint, spec: RefinementSpec, state: State) -> dict[str, Any]:
    """Progress of a job as JSON values."""
    if isinstance(checkpoint, QualityCheckpoint):
        own = checkpoint.progress()
    else:
        own = _error_progress(checkpoint)
        own["note"] = "no usage was recorded" if spec.weighted_by_traffic and not state["cells"] else ""
    ratio = 1.0 if state["stopped"] else max(own["pseudo"] / max(spec.max_pseudo, 1), state["spent_s"] / spec.budget_s)
    run = {"ratio": round(min(ratio, 1.0), 4), "spent_s": state["spent_s"], "stopped": state["stopped"]}
    return run | {"steps": checkpoint.steps} | own


def _error_progress(checkpoint: Checkpoint) -> dict[str, Any]:
    """Pseudo-examples and errors; errors are shares of the diagonal."""
    curves = {name: [list(row) for row in curve] for name, curve in zip(SETS, checkpoint.curves, strict=False)}
    pseudo, mean, top = checkpoint.curves[0][-1] if checkpoint.curves[0] else (0, None, None)
    pseudo = max((curve[-1][0] for curve in checkpoint.curves if curve), default=pseudo)
    return {
        "pseudo": pseudo,
        "error_mean": mean,
        "error_max": top,
        "curve": curves["uniform"],
        "curve_traffic": curves.get("traffic", []),
    }
