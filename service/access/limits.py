"""How much a caller may do: requests, streams and refinements, per key and per address.

Requests are counted in windows that start with a request. One process counts in its memory; several together count in a
Redis-compatible server, by the library ``limits``. That library's own memory starts a thread every 10 ms to remove old
counts, which costs a sixth of a pose; the database of the store would need a transaction for every pose.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import lru_cache
from typing import Any, Literal, Protocol, cast

import structlog
from limits import RateLimitItem, RateLimitItemPerDay, WindowStats, parse_many
from starlette.types import Scope

from service.access.access import Caller
from service.errors import Overloaded, TooManyRequests, TooManyStreams
from service.settings import Settings

__all__ = ["Limits", "address_of"]

MAX_COUNTED = 100_000
"""Largest number of keys and addresses that are counted in memory; beyond, counting begins anew."""

MAX_ADDRESS = 64
"""Longest text that is counted as an address."""

MAX_FOLLOWERS = 64
"""Clients of a process that follow refinements; each reads the database twice a second."""

RETRY_STORAGE_S = 5.0
"""Time for which requests are counted in memory after the shared storage failed, seconds."""

Counted = Literal["key", "address"]

log = structlog.get_logger("adverb.access")


class _Shared(Protocol):
    """Limiter whose storage several processes share."""

    storage: Any

    def hit(self, item: RateLimitItem, *identifiers: str, cost: int = 1) -> Awaitable[bool]: ...

    def get_window_stats(self, item: RateLimitItem, *identifiers: str) -> Awaitable[WindowStats]: ...


def address_of(scope: Scope) -> str:
    """Address of a client: of IPv6 the network (/64), which one client has as a whole.

    A socket for both families has the IPv4 address of a client inside an IPv6 address.
    """
    client = scope.get("client")
    return "unknown" if client is None else _network(str(client[0]))


@lru_cache(maxsize=4096)
def _network(host: str) -> str:
    if ":" not in host:
        return host[:MAX_ADDRESS]
    try:
        address = ipaddress.IPv6Address(host.partition("%")[0])
    except ValueError:  # of a proxy's header
        return host[:MAX_ADDRESS]
    return str(address.ipv4_mapped or ipaddress.IPv6Network((address, 64), strict=False))


class Limits:
    """Limits of a server; what is not set is not limited.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._rates: dict[Counted, list[RateLimitItem]] = {
            "key": parse_many(settings.rate_per_key) if settings.rate_per_key else [],
            "address": parse_many(settings.rate_per_address) if settings.rate_per_address else [],
        }
        daily = settings.refine_s_per_day
        self._refining = None if daily is None else RateLimitItemPerDay(int(daily))
        self._streams = {"key": settings.streams_per_key, "address": settings.streams_per_address}
        self._open: Counter[tuple[str, str, str]] = Counter()
        self._followers = 0
        self._windows: dict[str, list[float]] = {}
        self._pool = _pool_of(settings.rate_storage)
        self._shared = _shared(settings.rate_storage, self._pool)
        self._shared_again_s = 0.0

    def counts(self, kind: Counted) -> bool:
        """Whether requests are limited per key, or per address."""
        return bool(self._rates[kind])

    @property
    def counts_in_memory(self) -> bool:
        """Whether requests are counted in the memory of this process, for now."""
        return self._shared is None or time.monotonic() < self._shared_again_s

    def count(self, kind: Counted, name: str) -> None:
        """Count a request in memory, without a coroutine; raises :class:`TooManyRequests`."""
        for item in self._rates[kind]:
            self._count(item, kind, name, 1, "requests")

    async def request(self, kind: Counted, name: str) -> None:
        """Count a request of a key (its id) or of an address; raises :class:`TooManyRequests`."""
        if self.counts_in_memory:
            self.count(kind, name)
            return
        for item in self._rates[kind]:
            await self._hit(item, kind, name, 1, "requests")

    @asynccontextmanager
    async def refinement(self, caller: Caller, address: str, budget_s: float) -> AsyncIterator[None]:
        """While a refinement is started: its budget is counted unless that fails; raises :class:`TooManyRequests`."""
        if self._refining is None:
            yield
            return
        kind, name = ("refine key", caller.id) if caller.id else ("refine address", address)
        counted = self._refining, kind, name, max(1, math.ceil(budget_s))
        await self._hit(*counted, "seconds of refinement")
        try:
            yield
        except Exception:
            await self._give_back(*counted)
            raise

    @contextmanager
    def stream(self, caller: Caller, address: str) -> Iterator[None]:
        """While a stream is open; raises :class:`TooManyStreams`."""
        with self._one_more("streams", caller, address):
            yield

    @contextmanager
    def follower(self, caller: Caller, address: str) -> Iterator[None]:
        """While a refinement is followed: as many by a key or an address as streams.

        Raises :class:`TooManyStreams`, or :class:`Overloaded` beyond :data:`MAX_FOLLOWERS`.
        """
        if self._followers >= MAX_FOLLOWERS:
            detail = f"the server has its maximum of {MAX_FOLLOWERS} clients that follow refinements"
            raise Overloaded(detail, headers={"Retry-After": "5"}, limit=MAX_FOLLOWERS)
        with self._one_more("followed refinements", caller, address):
            self._followers += 1
            try:
                yield
            finally:
                self._followers -= 1

    @contextmanager
    def _one_more(self, what: str, caller: Caller, address: str) -> Iterator[None]:
        counted = [(what, "address", address), *([(what, "key", caller.id)] if caller.id else [])]
        for entry in counted:
            most = self._streams[entry[1]]
            if most is not None and self._open[entry] >= most:
                detail = f"this {entry[1]} has its maximum of {most} {what}"
                raise TooManyStreams(detail, headers={"Retry-After": "5"}, limit=most)
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

    async def _hit(self, item: RateLimitItem, kind: str, name: str, cost: int, what: str) -> None:
        if self._shared is None or self.counts_in_memory:
            self._count(item, kind, name, cost, what)
            return
        try:
            allowed = await self._shared.hit(item, kind, name, cost=cost)
            if not allowed and cost > 1:  # a part of the cost may have been left
                await self._add_shared(item, kind, name, -cost)
            end_s = 0.0 if allowed else (await self._shared.get_window_stats(item, kind, name)).reset_time
        except Exception as err:  # of any client library: a failed count must not fail the request
            self._shared_failed(err)
            self._count(item, kind, name, cost, what)
            return
        if not allowed:
            raise _refusal(item, kind, what, end_s)

    async def _give_back(self, item: RateLimitItem, kind: str, name: str, cost: int) -> None:
        if self._shared is None or self.counts_in_memory:
            window = self._windows.get(_key(item, kind, name))
            if window is not None:
                window[1] = max(0.0, window[1] - cost)
            return
        try:
            await self._add_shared(item, kind, name, -cost)
        except Exception as err:
            self._shared_failed(err)

    async def _add_shared(self, item: RateLimitItem, kind: str, name: str, cost: int) -> None:
        assert self._shared is not None  # callers check it
        await self._shared.storage.incr(item.key_for(kind, name), item.get_expiry(), amount=cost)

    def _shared_failed(self, err: Exception) -> None:
        self._shared_again_s = time.monotonic() + RETRY_STORAGE_S
        problem = str(err)[:200]
        log.warning("the storage of limits cannot be reached; requests are counted in memory", problem=problem)

    def _count(self, item: RateLimitItem, kind: str, name: str, cost: int, what: str) -> None:
        """Count in memory; what is refused is not counted."""
        now_s, key = time.monotonic(), _key(item, kind, name)
        window = self._windows.get(key)
        if window is None or window[0] <= now_s:
            if len(self._windows) >= MAX_COUNTED:
                self._forget(now_s)
            window = self._windows[key] = [now_s + item.get_expiry(), 0.0]
        if window[1] + cost > item.amount:
            raise _refusal(item, kind, what, time.time() + window[0] - now_s)
        window[1] += cost

    def _forget(self, now_s: float) -> None:
        """Remove the windows that have ended; all, where too many have not."""
        self._windows = {key: window for key, window in self._windows.items() if window[0] > now_s}
        if len(self._windows) > MAX_COUNTED // 2:
            self._windows.clear()


def _key(item: RateLimitItem, kind: str, name: str) -> str:
    return f"{kind} {item.multiples} {item.GRANULARITY.name} {name}"


def _refusal(item: RateLimitItem, kind: str, what: str, end_s: float) -> TooManyRequests:
    seconds = max(1, math.ceil(end_s - time.time()))
    detail = f"this {kind.removeprefix('refine ')} may have {item.amount} {what} per {_window(item)}"
    return TooManyRequests(detail, headers={"Retry-After": str(seconds)}, limit=item.amount)


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
