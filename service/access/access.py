"""Who may use a server: the keys of the store, kept in memory, and tokens of other issuers.

Keys are read from the store twice a second, so that a revoked key is refused within a second by every process. While
the database cannot be reached, the keys that were read last count.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import structlog

from service.access import keys
from service.access.tokens import Tokens
from service.compute import run_in_own_thread
from service.errors import MissingScope, NotReady, Unauthenticated
from service.settings import Settings
from service.store.keys import Keys
from service.store.records import Key, StoreError

__all__ = ["ANYONE", "CALLER", "POLL_S", "Access", "Caller", "allowed"]

CALLER = "adverb.caller"
"""Key of an ASGI scope with its :class:`Caller`."""

POLL_S = 0.4
"""Interval at which keys are read."""

EARLIEST_S = 0.1
"""Shortest time between two readings, seconds; an unknown key causes one, so that a new key is known at once."""

MAX_FOUND = 10_000
"""Keys that are remembered as found, so that not every request needs a hash."""

MAX_TOKEN = 8_192
"""Longest key or token, characters."""

REVOKED = 4401
"""Close code of a stream whose key was revoked or has expired."""

log = structlog.get_logger("adverb.access")


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sent a request.

    Parameters
    ----------
    author : str
        Text for records of changes.
    id : str
        Id of the key, or subject of the token; empty without.
    name : str
    scopes : frozenset of str
    expires_at_s : float or None
        Seconds since 1970, UTC.
    """

    author: str
    id: str
    name: str
    scopes: frozenset[str]
    expires_at_s: float | None = None


ANYONE = Caller("a client", "", "", frozenset(keys.SCOPES))
"""Caller of a server that needs no key."""


def allowed(caller: Caller, scope: str) -> bool:
    """Whether a caller has a scope."""
    return scope in caller.scopes or "admin" in caller.scopes


class Access:
    """Who may use this server.

    Parameters
    ----------
    settings : Settings
    public : bool
        Whether other machines can reach the server.

    Attributes
    ----------
    loaded : bool
        Whether the keys are known.
    """

    def __init__(self, settings: Settings, *, public: bool) -> None:
        self._mode = settings.keys
        self._always = settings.keys == "required" or (public and not settings.allow_public)
        self._tokens = Tokens.of_settings(settings)
        self._store: Keys | None = None
        self._keys: Mapping[str, Key] = {}
        self._found: dict[str, Caller] = {}
        self._revision, self._read_at_s = -1, 0.0
        self._reading: asyncio.Task[None] | None = None
        self._open: dict[Callable[[], None], Caller] = {}
        self.loaded = settings.keys == "off" or settings.data is None

    @property
    def required(self) -> bool:
        """Whether requests need a key: always, or by default as soon as one exists, also a revoked one."""
        if self._mode == "off":
            return False
        return self._always or bool(self._keys) or self._tokens is not None

    def load(self, store: Keys) -> None:
        """Read the keys; blocks. Raises :class:`StoreUnavailable`."""
        self._store = store
        self._take(store.changed(self._revision))
        self.loaded = True

    async def follow(self) -> None:
        """Read the keys again and again, and end the streams of keys that are not valid any more, until cancelled."""
        if self._mode == "off":
            return
        while True:
            await asyncio.sleep(POLL_S)
            await self._read()
            self._end_invalid()

    def known(self, text: str | None) -> Caller | None:
        """The caller with a key that was found before and is valid still; else None."""
        caller = None if text is None else self._found.get(text)
        if caller is not None and caller.expires_at_s is not None and caller.expires_at_s <= time.time():
            return None
        return caller

    async def find(self, text: str) -> Caller:
        """The caller with a key or token.

        Raises
        ------
        Unauthenticated
            The key is unknown, revoked or expired, or the token is not valid here.
        NotReady
            The keys are not known yet.
        """
        if not self.loaded:
            raise NotReady("keys are being loaded", headers={"Retry-After": "1"})
        if not text or len(text) > MAX_TOKEN:
            raise _refusal("the key is empty or too long")
        id = keys.id_of(text)
        if id is None:
            return await self._of_token(text)
        if id not in self._keys:
            await asyncio.sleep(max(0.0, self._read_at_s + EARLIEST_S - time.monotonic()))
            await self._read()
        key = self._keys.get(id)
        if key is None or not keys.matches(text, key):
            raise _refusal("the key is unknown")
        if key.revoked_at_s is not None:
            raise _refusal(f"the key {id} was revoked")
        if not key.valid_at(time.time()):
            raise _refusal(f"the key {id} has expired")
        caller = _caller(key)
        if len(self._found) >= MAX_FOUND:
            self._found.clear()
        self._found[text] = caller
        return caller

    def check(self, caller: Caller, scope: str) -> None:
        """Raise :class:`MissingScope` if a caller does not have a scope."""
        if not allowed(caller, scope):
            has = ", ".join(sorted(caller.scopes)) or "none"
            raise MissingScope(f"this needs a key with the scope '{scope}'; yours has {has}", scope=scope)

    @contextmanager
    def watching(self, caller: Caller, end: Callable[[int, str], None]) -> Iterator[None]:
        """While a stream is open: call ``end`` with close code and reason once its key is not valid any more."""
        entry = partial(end, REVOKED, "the key was revoked or has expired")
        self._open[entry] = caller
        try:
            yield
        finally:
            self._open.pop(entry, None)

    async def _of_token(self, text: str) -> Caller:
        # A client may have encoded a key as base64url once more, as for a subprotocol.
        decoded = _decoded(text) if "." not in text else None
        if decoded is not None:
            return await self.find(decoded)
        if self._tokens is None:
            raise _refusal("the key is unknown")
        subject, scopes, expires_at_s = await self._tokens.verify(text)
        return Caller(f"token of {subject}", subject, subject, scopes, expires_at_s)

    async def _read(self) -> None:
        """Read the keys once; several callers share one reading, which no cancelled request stops."""
        if self._reading is None or self._reading.done():
            self._reading = asyncio.create_task(self._read_once())
        await asyncio.shield(self._reading)

    async def _read_once(self) -> None:
        if self._store is None:
            return
        try:
            self._take(await run_in_own_thread(partial(self._store.changed, self._revision)))
        except StoreError as err:
            log.debug("keys cannot be read; the last ones count", problem=str(err))
        self._read_at_s = time.monotonic()

    def _take(self, found: tuple[int, list[Key]] | None) -> None:
        self._read_at_s = time.monotonic()
        if found is not None:
            self._revision = found[0]
            self._keys = {key.id: key for key in found[1]}
            self._found.clear()

    def _end_invalid(self) -> None:
        """End streams whose caller could not open one now."""
        now_s = time.time()
        for end, caller in list(self._open.items()):
            key = self._keys.get(caller.id)
            invalid = caller is ANYONE and self.required
            invalid |= key is not None and not key.valid_at(now_s)
            invalid |= caller.expires_at_s is not None and caller.expires_at_s <= now_s
            if invalid:
                end()


def _caller(key: Key) -> Caller:
    label = f"key {key.id} ({key.name})" if key.name else f"key {key.id}"
    return Caller(label, key.id, key.name, key.scopes, key.expires_at_s)


def _decoded(text: str) -> str | None:
    """A key in base64url."""
    try:
        found = base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)).decode("ascii")
    except (binascii.Error, ValueError):
        return None
    return found if keys.id_of(found) else None


def _refusal(detail: str) -> Unauthenticated:
    return Unauthenticated(detail, headers={"WWW-Authenticate": 'Bearer realm="adverb", error="invalid_token"'})
