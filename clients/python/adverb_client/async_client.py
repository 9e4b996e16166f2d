"""The asynchronous REST client."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx

from adverb_client import models
from adverb_client.api import Adverbs, Crowd, Numbers, Operation, PoseOptions, Request, Response, Track, error_of
from adverb_client.authoring_calls import AsyncAuthoringCalls
from adverb_client.authoring_models import Refinement
from adverb_client.errors import TimedOut, TransportError, Unavailable
from adverb_client.motion_api import EVENTS, events_path, refinements_of
from adverb_client.motion_calls import AsyncMotionCalls
from adverb_client.transport import POLL_S, BaseClient, auth_headers, httpx_request, response_of, transport_error

__all__ = ["AsyncClient"]

T = TypeVar("T")


class AsyncClient(AsyncAuthoringCalls, AsyncMotionCalls, BaseClient):
    """Asynchronous REST client; parameters and results are those of :class:`Client`.

    Examples
    --------
    >>> async with AsyncClient("http://127.0.0.1:8000") as client:
    ...     crowd = await client.poses("reach", {"x": [-0.3, -0.1], "y": 1.2, "z": 0.4}, phases=0.5)
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        api_key: str | None = None,
        timeout_s: float = 10.0,
        retries: int = 3,
        max_wait_s: float = 2.0,
        transport: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        super().__init__(retries, max_wait_s)
        self._sleep = sleep
        self._http = httpx.AsyncClient(
            base_url=url, headers=auth_headers(api_key), timeout=timeout_s, transport=transport
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()

    async def _run(self, operation: Operation[T]) -> T:
        try:
            request = next(operation)
            while True:
                request = operation.send(await self._send(request))
        except StopIteration as done:
            found: T = done.value
            return found

    async def _send(self, request: Request) -> Response:
        backoff = self._backoff()
        while True:
            response = await self._send_once(request)
            wait_s = self._wait_s(request, response, backoff)
            if wait_s is None:
                return response
            await self._sleep(wait_s)

    async def _send_once(self, request: Request) -> Response:
        try:
            return response_of(await self._http.send(httpx_request(self._http, request)))
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise transport_error(err, self._http.base_url) from err

    async def health(self) -> models.Health:
        """As :meth:`~adverb_client.Client.health`."""
        return await self._run(self._api.health())

    async def wait_ready(self, timeout_s: float = 120.0) -> models.Health:
        """As :meth:`~adverb_client.Client.wait_ready`."""
        end = time.monotonic() + timeout_s
        while True:
            try:
                return await self.health()
            except (TransportError, Unavailable) as err:
                if time.monotonic() + POLL_S > end:
                    raise TimedOut(f"not ready within {timeout_s:g} s: {err}") from err
            await self._sleep(POLL_S)

    async def verbs(self) -> tuple[models.VerbSummary, ...]:
        """As :meth:`~adverb_client.Client.verbs`."""
        return await self._run(self._api.verbs())

    async def verb(self, name: str) -> models.Verb:
        """As :meth:`~adverb_client.Client.verb`."""
        return await self._run(self._api.verb(name))

    async def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Pose:
        """As :meth:`~adverb_client.Client.pose`."""
        return await self._run(self._api.pose(verb, adverbs, phase, time_s, max_error, options))

    async def poses(
        self,
        verb: str,
        adverbs: Crowd,
        *,
        phases: Numbers | float | None = None,
        times_s: Numbers | float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Poses:
        """As :meth:`~adverb_client.Client.poses`."""
        return await self._run(self._api.poses(verb, adverbs, phases, times_s, options))

    async def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> models.Sequence:
        """As :meth:`~adverb_client.Client.sequence`."""
        return await self._run(self._api.sequence(verb, adverbs, track, fps, cycles, options))

    async def bvh(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> str:
        """As :meth:`~adverb_client.Client.bvh`."""
        return await self._run(self._api.bvh(verb, adverbs, track, fps, cycles, options))

    async def follow_refinement(self, id: str) -> AsyncIterator[Refinement]:
        """As :meth:`~adverb_client.Client.follow_refinement`."""
        try:
            async with self._http.stream("GET", events_path(id), headers={"accept": EVENTS}, timeout=None) as response:
                if response.status_code != httpx.codes.OK:
                    await response.aread()
                    raise error_of(response_of(response))
                async for line in response.aiter_lines():
                    for state in refinements_of((line,)):
                        yield state
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise transport_error(err, self._http.base_url) from err
