"""Requests of a load: sent on a schedule, timed from their scheduled time, and checked."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from adverb_client import DecodeError
from adverb_client.records import CLAMPED, joint_count, parse_records

from adverb_load.effector_errors import AGREE_M
from adverb_load.http_pool import Job, Pool, Reply, request_bytes
from adverb_load.profile import Requests
from adverb_load.series import Counts, Series
from adverb_load.stream_load import paced
from adverb_load.target import Target

__all__ = ["RequestLoad"]

F64 = npt.NDArray[np.float64]

JSON, OCTETS = "application/json", "application/octet-stream"
OK = 200
CHECKS = 50
"""Responses that are checked in one sweep; more are counted, not checked: parsing must not delay arrivals."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A request: its bytes, the goals (B, D), and whether the poses are at the effector's keytime."""

    content: bytes
    goals: F64
    measured: bool


class RequestLoad:
    """A group of requests.

    Parameters
    ----------
    plan : Requests
    target : Target
    seed : int
    interval_s : float
    """

    def __init__(self, plan: Requests, target: Target, seed: int, interval_s: float) -> None:
        self.plan, self._target, self._seed = plan, target, seed
        self._rng = np.random.default_rng([seed, 1])
        self._verb = None if plan.route in ("verbs", "health") else target.verb(plan.verb)
        self.latency, self.service, self.wait, self.error = (Series(interval_s) for _ in range(4))
        self.counts, self.errors = Counts(interval_s), Counts(interval_s)
        self.problems: list[str] = []
        self._pool = Pool(target.url, limit=plan.connections, timeout_s=plan.timeout_s)
        self._unchecked: list[tuple[float, Made, Reply]] = []
        self._made: dict[Job, Made] = {}

    async def open(self) -> None:
        """Connections are opened when they are needed."""

    @property
    def live(self) -> int:
        """Requests that can be sent: 1."""
        return 1

    def window(self, start_s: float, seconds: float) -> None:
        """Begin the measurement."""
        for one in (self.latency, self.service, self.wait, self.error, self.counts, self.errors):
            one.window(start_s, seconds)

    def tasks(self, start_s: float) -> list[asyncio.Task[None]]:
        """Start the schedule."""
        work = paced(start_s, self.plan.rate, self.plan.arrivals, self._seed, self._submit)
        return [asyncio.get_running_loop().create_task(work)]

    # ── requests ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _submit(self, due_s: float) -> None:
        made = self._make()
        job = Job(made.content, due_s, self._ended)
        self._made[job] = made
        self.counts.add(due_s, "scheduled")
        self._pool.submit(job)

    def _make(self) -> Made:
        plan, builders = self.plan, _BUILDERS
        return builders.get(plan.route, RequestLoad._get)(self)

    def _get(self) -> Made:
        path = {"verbs": "/v1/verbs", "health": "/readyz"}.get(self.plan.route, self._path(""))
        return self._request("GET", path, JSON)

    def _quality(self) -> Made:
        method = f"&method={quote(self.plan.method, safe='')}" if self.plan.method else ""
        return self._request("GET", self._path(f"/quality?nodes={self.plan.nodes}{method}"), JSON)

    def _pose(self) -> Made:
        goals, phase = self._goals(1)
        body: dict[str, Any] = {"adverbs": self._named(goals[0]), "phase": phase}
        return self._poses_made("/pose", body, goals)

    def _batch(self) -> Made:
        plan = self.plan
        goals, phase = self._goals(plan.batch)
        if plan.accept == "json":
            body = {"items": [{"adverbs": self._named(row), "phase": phase} for row in goals]}
            return self._poses_made("/poses", body, goals)
        rows = np.concatenate([goals, np.full((len(goals), 1), phase)], axis=1).astype("<f4").tobytes()
        query = f"?method={quote(plan.method, safe='')}" if plan.method else ""
        return self._request("POST", self._path("/poses" + query), OCTETS, rows, OCTETS, goals)

    def _sequence(self) -> Made:
        goals, _ = self._goals(1)
        return self._poses_made("/sequence", {"adverbs": self._named(goals[0])}, goals)

    def _poses_made(self, path: str, body: dict[str, Any], goals: F64) -> Made:
        if self.plan.method:
            body["method"] = self.plan.method
        accept = JSON if self.plan.accept == "json" else OCTETS
        return self._request("POST", self._path(path), accept, json.dumps(body).encode(), JSON, goals)

    def _request(
        self, method: str, path: str, accept: str, body: bytes = b"", kind: str = "", goals: F64 | None = None
    ) -> Made:
        headers = {"Accept": accept, **self._target.headers}
        if kind:
            headers["Content-Type"] = kind
        content = request_bytes(method, self._target.url, path, headers, body)
        measured = self.plan.route in ("pose", "poses") and self.plan.phase == "keytime"
        return Made(content, np.zeros((0, 3)) if goals is None else goals, measured)

    def _path(self, rest: str) -> str:
        return f"/v1/verbs/{quote(self.plan.verb, safe='')}{rest}"

    def _goals(self, count: int) -> tuple[F64, float]:
        assert self._verb is not None
        rows, effector = self._verb.goals.rows, self._verb.effector
        chosen = rows[self._rng.integers(0, len(rows), count)].astype(np.float64)
        at_keytime = self.plan.phase == "keytime" and effector is not None
        return chosen, effector.phase if at_keytime and effector is not None else round(self._rng.random(), 6)

    def _named(self, row: F64) -> dict[str, float]:
        assert self._verb is not None
        return dict(zip(self._verb.goals.names, row.tolist(), strict=True))

    # ── responses ────────────────────────────────────────────────────────────────────────────────────────────────

    def _ended(self, job: Job, found: Reply | str) -> None:
        made, due_s = self._made.pop(job), job.due_s
        if not math.isnan(job.sent_s):
            self.counts.add(due_s, "sent")
            self.wait.add(due_s, job.sent_s - due_s)
        if isinstance(found, str):
            self.errors.add(due_s, found)
            if found == "timeout":  # at least this long
                self.latency.add(due_s, job.ended_s - due_s)
            return
        self.latency.add(due_s, job.ended_s - due_s)
        self.service.add(due_s, job.ended_s - job.sent_s)
        self.counts.add(job.ended_s, "ended")
        if found.status != OK:
            self.errors.add(due_s, _code(found))
            return
        self.counts.add(due_s, "good")
        self.counts.add(due_s, "bytes", len(found.body))
        self._unchecked.append((due_s, made, found))

    def sweep(self) -> None:
        """End what is overdue, and check some responses."""
        self._pool.expire(time.monotonic())
        batch, rest = self._unchecked[:CHECKS], self._unchecked[CHECKS:]
        self._unchecked = []
        for due_s, made, reply in batch:
            try:
                self._check(due_s, made, reply)
                self.counts.add(due_s, "checked")
            except (DecodeError, ValueError, KeyError, TypeError) as err:
                self.counts.add(due_s, "faults")
                if len(self.problems) < 8:
                    self.problems.append(f"{self.plan.route}: {err}"[:300])
        for due_s, _, _ in rest:
            self.counts.add(due_s, "unchecked")

    def _check(self, due_s: float, made: Made, reply: Reply) -> None:
        if self.plan.route not in ("pose", "poses", "sequence"):
            json.loads(reply.body)
            return
        root, rotations, stated, clamped = self._parsed(reply, len(made.goals))
        if self._verb is None or self._verb.effector is None or not made.measured:
            return
        errors = self._verb.effector.errors(made.goals, root, rotations)
        for error, other in zip(errors[~clamped].tolist(), stated[~clamped].tolist(), strict=True):
            self.error.add(due_s, error)
            self.counts.add(due_s, "measured")
            if abs(error - other) > AGREE_M["f32"]:
                self.counts.add(due_s, "disagree")
        self.counts.add(due_s, "clamped", int(clamped.sum()))

    def _parsed(self, reply: Reply, count: int) -> tuple[F64, F64, F64, npt.NDArray[np.bool_]]:
        """Root (B, 3), rotations (B, J, 4), errors and clamped (B,) of a response."""
        assert self._verb is not None
        if self.plan.accept == "binary":
            joints = self._verb.joints if self.plan.route == "sequence" else joint_count(reply.body, count)
            rows = parse_records(reply.body, joints)
            return (rows["root"].astype(np.float64), rows["rotations"].astype(np.float64),
                    rows["error"].astype(np.float64), (rows["flags"] & CLAMPED).astype(bool))  # fmt: skip
        found = json.loads(reply.body)
        if self.plan.route == "sequence":
            return np.array(found["root"]), np.array(found["rotations"]), np.zeros(0), np.zeros(0, bool)
        poses = found["poses"] if self.plan.route == "poses" else [found]
        stated = np.array([np.nan if pose["error"] is None else pose["error"] for pose in poses])
        return (np.array([pose["root"] for pose in poses]), np.array([pose["rotations"] for pose in poses]), stated,
                np.array([pose["clamped"] for pose in poses], bool))  # fmt: skip

    # ── the end ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def close(self) -> None:
        """Close all connections."""
        self._pool.close()

    def unfinished(self, end_s: float) -> int:
        """Requests without a response so far; all are scheduled before ``end_s``."""
        return len(self._made)

    def result(self, seconds: float) -> dict[str, Any]:
        """The group's part of the report, from the first seconds of the window."""
        plan = self.plan
        names = (
            "scheduled",
            "sent",
            "good",
            "bytes",
            "checked",
            "unchecked",
            "measured",
            "disagree",
            "clamped",
            "faults",
        )
        total = {name: sum(self.counts.parts(name, seconds)) for name in names}
        ended = sum(self.counts.parts("ended", seconds))
        series = {"latency_s": self.latency, "service_s": self.service, "wait_s": self.wait, "error_m": self.error}
        return {
            "name": plan.name,
            "plan": {"route": plan.route, "verb": plan.verb, "accept": plan.accept, "rate": plan.rate,
                     "arrivals": plan.arrivals},
            "requests": {"target_per_s": round(plan.rate, 3), "scheduled_per_s": round(total["scheduled"] / seconds, 2),
                         "sent_per_s": round(total["sent"] / seconds, 2), "per_s": round(ended / seconds, 2), **total,
                         "connections": self._pool.most},
            "errors": {name: sum(self.errors.parts(name, seconds)) for name in self.errors.names()},
            "problems": self.problems,
            "summary": {name: one.whole(seconds).summary() for name, one in series.items()},
            "series": {name: one.to_json(seconds) for name, one in series.items()},
            "per_interval": {name: self.counts.parts(name, seconds) for name in ("scheduled", "sent", "ended", "good")},
        }  # fmt: skip


_BUILDERS: dict[str, Callable[[RequestLoad], Made]] = {
    "pose": RequestLoad._pose,
    "poses": RequestLoad._batch,
    "sequence": RequestLoad._sequence,
    "quality": RequestLoad._quality,
}


def _code(reply: Reply) -> str:
    """The code of a problem, or the status."""
    try:
        return f"{reply.status} {json.loads(reply.body)['code']}"
    except (ValueError, KeyError, TypeError):
        return str(reply.status)
