"""What the store, the servers and the folders have after a run."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable
from contextlib import closing, suppress

import httpx
import numpy as np

from benchmarks.chaos.cluster import Cluster
from benchmarks.chaos.ledger import Ledger, Refined
from benchmarks.chaos.verdict import Found, history_problems
from service.http.routes.refinements import ENDED
from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import Scheduler
from service.refinement.usage import Usage
from service.store.store import ORPHAN_S, Event, Store, UnknownVerb, Version
from verbs import Evaluator
from verbs.io import artifact

__all__ = ["ENDED", "collected", "inspect", "job_states", "listed"]

LIST_S = 20.0
"""Time in which all servers serve what the store has, seconds."""
MAX_JOBS = MAX_EVENTS = 100_000
METRICS = "adverb-metrics-"
"""Start of the name of the temporary folder that stays while servers run."""


def job_states(cluster: Cluster, ledger: Ledger) -> dict[str, tuple[str, float]]:
    """State, and time of the last change, of each refinement that was accepted."""
    with closing(Store.open(cluster.database, str(cluster.data / "artifacts"))) as store:
        return {row.id: (row.state, row.updated_at_s) for row in store.jobs(limit=MAX_JOBS) if row.id in ledger.jobs}


def inspect(cluster: Cluster, ledger: Ledger) -> Found:
    """Read everything: the store, every artifact, and the list of every server."""
    with closing(Store.open(cluster.database, str(cluster.data / "artifacts"))) as store:
        current = {verb: version.number for verb, version in store.current().items()}
        verbs = set(current) | {verb for verb, _ in ledger.versions}
        rows, disorder = [], []
        refined: dict[tuple[str, int], Refined] = {}
        for verb in sorted(verbs):
            with suppress(UnknownVerb):  # lost: the check of versions finds it
                own, history = store.versions(verb), store.history(verb, limit=MAX_EVENTS)
                parents = {row.number: row.parent for row in own if row.parent is not None}
                disorder += history_problems(verb, history, parents, current.get(verb))
                refined |= {
                    (verb, number): Refined(parent, _became_current_s(history, number, ledger))
                    for number, parent in parents.items()
                }
                rows += own
        unreadable = [problem for version in rows if (problem := _problem(store, version))]
        jobs = {row.id: row.state for row in store.jobs(limit=MAX_JOBS) if row.id in ledger.jobs}
    return Found(
        {(row.verb, row.number): row.sha256 for row in rows},
        current,
        refined,
        tuple(disorder),
        tuple(unreadable),
        listed(cluster.base, current),
        jobs,
    )


def _became_current_s(history: Iterable[Event], number: int, ledger: Ledger) -> float:
    """The last time at which a version became current, from the start of the run, seconds; -inf for never."""
    times_s = [event.at_s for event in history if event.current == event.number == number]
    return max(times_s, default=-math.inf) - time.time() + ledger.now_s()


def _problem(store: Store, version: Version) -> str:
    """Why a version cannot be read, or an empty text; a pose of each example is computed."""
    name = f"{version.verb} {version.number}"
    try:
        path = store.path(version)
        if hashlib.sha256(path.read_bytes()).hexdigest() != version.sha256:
            return f"{name}: its file has another hash"
        verb = artifact.load(path)
        evaluator = Evaluator(verb)
        poses = evaluator.pose(verb.values, phase=np.full(len(verb.values), 0.5))
    except Exception as err:  # whatever it is, the version is not readable
        return f"{name}: {type(err).__name__} {err}"
    return "" if np.isfinite(poses.rotations).all() else f"{name}: its poses are not finite"


def listed(base: str, current: dict[str, int]) -> dict[str, dict[str, int]]:
    """Versions that some connections list, each to whichever server accepts it, once they agree with the store."""
    found: dict[str, dict[str, int]] = {}
    end = time.monotonic() + LIST_S
    while not found or (any(rows != current for rows in found.values()) and time.monotonic() < end):
        for number in range(16):
            with httpx.Client(base_url=base, timeout=30.0) as http:
                rows = http.get("/v1/verbs").json()["verbs"]
            found[f"connection {number}"] = {row["name"]: row["version"] for row in rows}
        time.sleep(0.2)
    return found


def collected(cluster: Cluster, verbs: Iterable[str]) -> list[str]:
    """Names of files that stay although nothing refers to them, after a collection as a server does it an hour later.

    Parameters
    ----------
    cluster : Cluster
    verbs : iterable of str
        All verbs, also deleted ones.
    """
    artifacts, uploads = cluster.data / "artifacts", cluster.data / "uploads"
    with closing(Store.open(cluster.database, str(artifacts))) as store:
        parts = store, Refinements(cluster.database, store), Usage(), Metrics()
        scheduler = Scheduler(*parts, uploads=uploads, refine_above=None, started_s=0.0)
        scheduler.run_once([], time.time() + ORPHAN_S + 60.0)
        rows = [row for verb in verbs for row in store.versions(verb)]
    used = {f"{name}.verb" for row in rows for name in (row.sha256, row.source_sha256)}
    left = [path for path in artifacts.iterdir() if path.is_file() and path.name not in used]
    left += (artifacts / "jobs").glob("*/*")  # of refinements, which have all ended
    left += [*uploads.iterdir(), *(path for path in cluster.temporary.iterdir() if not path.name.startswith(METRICS))]
    return sorted(f"{path.parent.name}/{path.name}" for path in left)
