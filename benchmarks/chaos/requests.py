"""Requests over REST, whose answers are computed again on the client, and connections that are cut."""

from __future__ import annotations

import asyncio
import random
import socket
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
from adverb_client import AdverbError, AsyncClient, DecodeError, ResponseError
from adverb_load.effector import Effector
from adverb_load.goals import Goals

from benchmarks.chaos.ledger import Ledger

__all__ = ["TOLERANCE_M", "Cutter", "Requester", "problem_of", "response_problem"]

TOLERANCE_M = 1e-6
"""Largest difference of the effector of a pose from its measured value, and of errors, metres."""
REST_S = (0.05, 0.3)
PER_CONNECTION = 30
"""Requests of a client before it connects again, perhaps to another server."""
BATCH = 50
TIMEOUT_S = 45.0


def problem_of(err: Exception) -> str:
    """A short name of what went wrong: status and code, or the error of the connection."""
    if isinstance(err, ResponseError):
        return f"{err.status} {err.code}"
    cause = err.__cause__ if isinstance(err, AdverbError) and err.__cause__ is not None else err
    return type(cause).__name__


def response_problem(response: httpx.Response) -> str:
    """Status and code of a response that is an error."""
    try:
        return f"{response.status_code} {response.json()['code']}"
    except (ValueError, KeyError, TypeError):
        return f"{response.status_code} without a code"


class Requester:
    """One client that requests poses and other things of the streamed verbs.

    Parameters
    ----------
    base : str
    verbs : dict of str to dict
        Descriptions of the verbs whose adverbs are the position of a joint.
    goals : dict of str to Goals
    rng : Random
    ledger : Ledger
    """

    def __init__(
        self, base: str, verbs: dict[str, dict[str, Any]], goals: dict[str, Goals], rng: random.Random, ledger: Ledger
    ) -> None:
        self.base, self.verbs, self.goals, self.rng, self.ledger = base, verbs, goals, rng, ledger
        self._effectors = {name: found for name, verb in verbs.items() if (found := Effector.of(verb)) is not None}
        self._joints = {
            name: verb["skeleton"]["names"].index(verb["measure"]["effector"]) for name, verb in verbs.items()
        }
        self._kinds: list[Callable[[AsyncClient, str], Awaitable[None]]] = [
            *(3 * [self.pose]), *(2 * [self.poses]), self.sequence, self.listing, self.description, self.quality,
            self.versions,
        ]  # fmt: skip

    async def run(self, stop: asyncio.Event) -> None:
        """Request until the end; an error is recorded, and the next request is made on a new connection."""
        while not stop.is_set():
            async with AsyncClient(self.base, retries=0, timeout_s=TIMEOUT_S) as client:
                for _ in range(PER_CONNECTION):
                    if stop.is_set() or not await self._once(client):
                        break
                    await asyncio.sleep(self.rng.uniform(*REST_S))
            await asyncio.sleep(self.rng.uniform(*REST_S))

    async def _once(self, client: AsyncClient) -> bool:
        """One request; whether it was answered."""
        kind, verb, began_s = self.rng.choice(self._kinds), self.rng.choice(list(self.verbs)), self.ledger.now_s()
        what = f"{kind.__name__} of {verb}"
        try:
            await kind(client, verb)
        except DecodeError as err:
            self.ledger.fault(f"{what}: {err}")
        except (AdverbError, httpx.HTTPError) as err:
            self.ledger.failed(began_s, what, problem_of(err))
            return isinstance(err, ResponseError)
        else:
            self.ledger.done[kind.__name__] += 1
        return True

    async def pose(self, client: AsyncClient, verb: str) -> None:
        """One pose at the effector's keytime, as JSON; ``measured`` and ``error`` are computed again."""
        effector, goal = self._effectors[verb], self.goals[verb].adverbs(self.rng.getrandbits(10))
        pose = await client.pose(verb, goal, phase=effector.phase, full=True)
        if pose.measured is None or pose.error is None:
            self.ledger.fault(f"a pose of {verb} has no measured value")
            return
        point = effector.points(pose.root.astype(np.float64), pose.rotations.astype(np.float64))
        measured = np.array([pose.measured[axis] for axis in "xyz"])
        self._compare("REST JSON, measured", float(np.linalg.norm(point - measured)), verb)
        if not pose.clamped:
            error_m = float(np.linalg.norm(measured - np.array(list(goal.values()))))
            self._compare("REST JSON, error", abs(error_m - pose.error), verb)

    async def poses(self, client: AsyncClient, verb: str) -> None:
        """Many poses as records; each error is computed again."""
        effector, goals = self._effectors[verb], self.goals[verb]
        rows = goals.rows[self.rng.randrange(len(goals.rows) - BATCH) :][:BATCH]
        poses = await client.poses(verb, rows, phases=effector.phase)
        apart = effector.errors(
            rows.astype(np.float64), poses.root.astype(np.float64), poses.rotations.astype(np.float64)
        )
        inside = ~poses.clamped
        if inside.any():
            worst = float(np.abs(apart - poses.errors)[inside].max())
            self._compare("REST records, error", worst, verb, int(inside.sum()))

    def _compare(self, kind: str, difference_m: float, verb: str, count: int = 1) -> None:
        self.ledger.compare(kind, difference_m, count)
        if not difference_m <= TOLERANCE_M:
            self.ledger.fault(f"{kind} of {verb}: {difference_m:.3g} m beside the value computed on the client")

    async def sequence(self, client: AsyncClient, verb: str) -> None:
        """A whole motion; its error, and the place of the effector in each frame are computed again."""
        effector, goal = self._effectors[verb], self.goals[verb].adverbs(self.rng.getrandbits(10))
        found = await client.sequence(verb, goal, fps=30, full=True, space="global")
        if not len(found) or not np.isfinite(found.rotations).all():
            self.ledger.fault(f"a sequence of {verb} has {len(found)} frames, or numbers that are not finite")
            return
        if found.measured is None or found.positions is None:
            self.ledger.fault(f"a sequence of {verb} has no measured value, or no positions")
            return
        measured = np.array([found.measured[axis] for axis in "xyz"])
        if not found.clamped:
            error_m = float(np.linalg.norm(measured - np.array(list(goal.values()))))
            self._compare("REST sequence, error", float(np.abs(error_m - found.errors).max()), verb)
        points = effector.global_points(found.root.astype(np.float64), found.rotations.astype(np.float64))
        apart = np.linalg.norm(points - found.positions[:, self._joints[verb]], axis=-1)
        self._compare("REST sequence, positions", float(apart.max()), verb, len(found))

    async def listing(self, client: AsyncClient, verb: str) -> None:
        """The list of verbs; the streamed ones are never deleted."""
        names = {row.name for row in await client.verbs()}
        if verb not in names:
            self.ledger.fault(f"{verb} is not listed: {sorted(names)}")

    async def description(self, client: AsyncClient, verb: str) -> None:
        """The description of a verb."""
        await client.verb(verb)

    async def quality(self, client: AsyncClient, verb: str) -> None:
        """A small map of quality."""
        await self._get(client, f"/v1/verbs/{verb}/quality", nodes=5, across="x", up="y")

    async def versions(self, client: AsyncClient, verb: str) -> None:
        """The versions of a verb, from the database."""
        known = {number for name, number in self.ledger.versions if name == verb}
        rows = await self._get(client, f"/v1/verbs/{verb}/versions")
        if missing := known - {row["version"] for row in rows["versions"]}:
            self.ledger.fault(f"versions {sorted(missing)} of {verb} were acknowledged and are not listed")

    async def _get(self, client: AsyncClient, path: str, **query: Any) -> Any:
        """A JSON answer without a method of the client library."""
        response = await client._http.get(path, params=query)
        if response.status_code != 200:
            status, code = response_problem(response).split(" ", 1)
            raise ResponseError(response.text[:200], code=code, status=int(status))
        return response.json()


class Cutter:
    """Connections that send a part of something and are cut."""

    def __init__(self, base: str, rng: random.Random, ledger: Ledger) -> None:
        parts = urlsplit(base)
        self.host, self.port = str(parts.hostname), int(parts.port or 0)
        self.rng, self.ledger = rng, ledger

    async def run(self, stop: asyncio.Event) -> None:
        """Cut connections until the end."""
        while not stop.is_set():
            await asyncio.sleep(self.rng.uniform(0.2, 1.0))
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(5.0):
                    await self._cut()
                self.ledger.done["connections cut"] += 1

    async def _cut(self) -> None:
        reader, writer = await asyncio.open_connection(self.host, self.port)
        del reader
        writer.write(self.rng.choice(self._parts()))
        await asyncio.sleep(self.rng.uniform(0.0, 0.5))
        if self.rng.random() < 0.5:  # reset instead of an orderly end
            own = writer.get_extra_info("socket")  # None once the server has closed the connection
            if own is not None:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()

    def _parts(self) -> list[bytes]:
        host = f"Host: {self.host}:{self.port}\r\n"
        upload = (
            f"POST /v1/verbs HTTP/1.1\r\n{host}Content-Type: application/octet-stream\r\nContent-Length: 90000\r\n\r\n"
        )
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        shake = f"GET /v1/stream HTTP/1.1\r\n{host}Upgrade: websocket\r\nConnection: Upgrade\r\n{key}"
        whole = f"{shake}Sec-WebSocket-Protocol: adverb.v1\r\n\r\n"
        return [
            b"", b"POST /v1/verbs/reach/po", upload.encode(), upload.encode() + self.rng.randbytes(4_000),
            shake.encode(), whole.encode(), whole.encode() + b"\x81\xfe\x10\x00abc",
        ]  # fmt: skip
