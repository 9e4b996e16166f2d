"""The REST client whose answers are awaited."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx

from adverb_client import models
from adverb_client.api import Adverbs, Answer, Call, Crowd, Numbers, Options, Question, Track
from adverb_client.errors import TimedOut, TransportError, Unavailable
from adverb_client.transport import POLL_S, Shared, answer_of, failed, headers_of, request_of

__all__ = ["AsyncClient"]

T = TypeVar("T")


class AsyncClient(Shared):
    """A client whose answers are awaited; parameters and answers are those of :class:`Client`.

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
        longest_wait_s: float = 2.0,
        transport: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        super().__init__(retries, longest_wait_s)
        self._sleep = sleep
        self._http = httpx.AsyncClient(
            base_url=url, headers=headers_of(api_key), timeout=timeout_s, transport=transport
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

    async def _run(self, question: Question[T]) -> T:
        try:
            call = next(question)
            while True:
                call = question.send(await self._answered(call))
        except StopIteration as done:
            found: T = done.value
            return found

    async def _answered(self, call: Call) -> Answer:
        backoff = self._backoff()
        while True:
            answer = await self._once(call)
            wait_s = self._wait_s(call, answer, backoff)
            if wait_s is None:
                return answer
            await self._sleep(wait_s)

    async def _once(self, call: Call) -> Answer:
        try:
            return answer_of(await self._http.send(request_of(self._http, call)))
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise failed(err, self._http.base_url) from err

    async def health(self) -> models.Health:
        """As :meth:`~adverb_client.Client.health`."""
        return await self._run(self._asking.health())

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
        return await self._run(self._asking.verbs())

    async def verb(self, name: str) -> models.Verb:
        """As :meth:`~adverb_client.Client.verb`."""
        return await self._run(self._asking.verb(name))

    async def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[Options],
    ) -> models.Pose:
        """As :meth:`~adverb_client.Client.pose`."""
        return await self._run(self._asking.pose(verb, adverbs, phase, time_s, max_error, options))

    async def poses(
        self,
        verb: str,
        adverbs: Crowd,
        *,
        phases: Numbers | float | None = None,
        times_s: Numbers | float | None = None,
        **options: Unpack[Options],
    ) -> models.Poses:
        """As :meth:`~adverb_client.Client.poses`."""
        return await self._run(self._asking.poses(verb, adverbs, phases, times_s, options))

    async def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[Options],
    ) -> models.Sequence:
        """As :meth:`~adverb_client.Client.sequence`."""
        return await self._run(self._asking.sequence(verb, adverbs, track, fps, cycles, options))

    async def bvh(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[Options],
    ) -> str:
        """As :meth:`~adverb_client.Client.bvh`."""
        return await self._run(self._asking.bvh(verb, adverbs, track, fps, cycles, options))
