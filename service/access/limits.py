"""How much a caller may do: requests, streams and refinements, per key and per address.

Requests are counted in fixed windows by the library ``limits``: in memory, of this process, or in a Redis-compatible
server for several processes together. The database of the store is not used for it: a transaction for every pose would
take longer than the pose.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import Counter
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, cast

import structlog
from limits import RateLimitItem, RateLimitItemPerDay, parse_many
from limits.storage import MemoryStorage
from limits.strategies import FixedWindowRateLimiter
from starlette.types import Scope

from service.access.access import Caller
from service.errors import TooManyRequests, TooManyStreams
from service.settings import Settings

__all__ = ["Limits", "address_of"]

RETRY_STORAGE_S = 5.0
"""Time for which requests are counted in memory after the shared storage failed, seconds."""

log = structlog.get_logger("adverb.access")


class _Shared(Protocol):
    """Limiter whose storage several processes share."""

    def hit(self, item: RateLimitItem, *identifiers: str, cost: int = 1) -> Awaitable[bool]: ...


def address_of(scope: Scope) -> str:
    """Address of a client: of IPv6 the network (/64), which one client has as a whole."""
    client = scope.get("client")
    if client is None:
        return "unknown"
    host = str(client[0])
    return host if ":" not in host else str(ipaddress.ip_network(f"{host.partition('%')[0]}/64", strict=False))


class Limits:
    """Limits of a server; what is not set is not limited.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._of_key = parse_many(settings.rate_per_key) if settings.rate_per_key else []
        self._of_address = parse_many(settings.rate_per_address) if settings.rate_per_address else []
        daily = settings.refine_s_per_day
        self._refining = None if daily is None else RateLimitItemPerDay(int(daily))
        self._streams = {"key": settings.streams_per_key, "address": settings.streams_per_address}
        self._open: Counter[tuple[str, str]] = Counter()
        self._memory = MemoryStorage()
        self._local = FixedWindowRateLimiter(self._memory)
        self._pool = _pool_of(settings.rate_storage)
        self._shared = _shared(settings.rate_storage, self._pool)
        self._shared_again_s = 0.0

    @property
    def counts_requests(self) -> bool:
        """Whether requests are limited."""
        return bool(self._of_key or self._of_address)

    async def request(self, caller: Caller, address: str) -> None:
        """Count a request; raises :class:`TooManyRequests`."""
        if caller.id:
            for item in self._of_key:
                await self._hit(item, "key", caller.id)
        for item in self._of_address:
            await self._hit(item, "address", address)

    async def refine(self, caller: Caller, address: str, budget_s: float) -> None:
        """Count the budget of a refinement; raises :class:`TooManyRequests`."""
        if self._refining is not None:
            kind, name = ("key", caller.id) if caller.id else ("address", address)
            cost = max(1, math.ceil(budget_s))
            await self._hit(self._refining, f"refine {kind}", name, cost, "seconds of refinement")

    @contextmanager
    def stream(self, caller: Caller, address: str) -> Iterator[None]:
        """While a stream is open; raises :class:`TooManyStreams`."""
        counted = [("address", address), *([("key", caller.id)] if caller.id else [])]
        for kind, name in counted:
            most = self._streams[kind]
            if most is not None and self._open[kind, name] >= most:
                raise TooManyStreams(f"this {kind} has its maximum of {most} streams", limit=most)
        self._open.update(counted)
        try:
            yield
        finally:
            self._open.subtract(counted)
            for entry in counted:
                if self._open[entry] <= 0:
                    del self._open[entry]

    async def close(self) -> None:
        """Close the connections to the shared storage."""
        if self._pool is not None:
            await self._pool.aclose()

    async def _hit(self, item: RateLimitItem, kind: str, name: str, cost: int = 1, what: str = "requests") -> None:
        if not await self._allowed(item, kind, name, cost):
            seconds = self._reset_s(item)
            raise TooManyRequests(
                f"this {kind.removeprefix('refine ')} may have {item.amount} {what} per {_window(item)}",
                headers={"Retry-After": str(seconds)},
                limit=item.amount,
            )

    async def _allowed(self, item: RateLimitItem, kind: str, name: str, cost: int) -> bool:
        if self._shared is None or time.monotonic() < self._shared_again_s:
            return self._local.hit(item, kind, name, cost=cost)
        try:
            return await self._shared.hit(item, kind, name, cost=cost)
        except Exception as err:  # of any client library: a failed count must not fail the request
            self._shared_again_s = time.monotonic() + RETRY_STORAGE_S
            log.warning(
                "the storage of limits cannot be reached; requests are counted in memory", problem=str(err)[:200]
            )
            return self._local.hit(item, kind, name, cost=cost)

    @staticmethod
    def _reset_s(item: RateLimitItem) -> int:
        """Seconds until the next window; windows start at multiples of their length."""
        length = item.get_expiry()
        return max(1, math.ceil(length - time.time() % length))


def _pool_of(address: str) -> Any:
    """Connections to the storage that processes share; None for memory."""
    if address == "memory://":
        return None
    from redis.asyncio import ConnectionPool

    return ConnectionPool.from_url(address, socket_timeout=0.5, socket_connect_timeout=0.5, max_connections=64)


def _shared(address: str, pool: Any) -> _Shared | None:
    """A limiter with a storage that processes share; None for memory."""
    if pool is None:
        return None
    from limits.aio.strategies import FixedWindowRateLimiter as Shared
    from limits.storage import storage_from_string

    storage = storage_from_string(f"async+{address}", implementation="redispy", connection_pool=pool)
    return cast(_Shared, Shared(storage))


def _window(item: RateLimitItem) -> str:
    """Length of a window: ``second``, ``10 minutes``."""
    name = type(item).GRANULARITY.name
    return name if item.multiples == 1 else f"{item.multiples} {name}s"
