"""JSON Web Tokens of other issuers, such as the back-end of a game, verified by PyJWT."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from service.access.keys import SCOPES
from service.compute import run_in_own_thread
from service.errors import Unauthenticated
from service.settings import Settings

__all__ = ["ALGORITHMS", "Tokens"]

ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Signatures that are accepted: with a public key only."""

READ_S = 300.0
"""Age at which the issuer's keys are read again, seconds."""

EARLIEST_S = 10.0
"""Shortest time between two readings, seconds; a token with an unknown key causes one."""

TIMEOUT_S = 5.0
LEEWAY_S = 10.0
"""By how much clocks may differ, seconds."""

MAX_BYTES = 1024 * 1024
"""Longest set of keys."""

MAX_REMEMBERED = 4_096
"""Tokens that are remembered as valid, as a signature takes longer to verify than a pose to evaluate."""

log = structlog.get_logger("adverb.access")

Verified = tuple[str, frozenset[str], float]


class Tokens:
    """Verifies tokens with the public keys of their issuer.

    Parameters
    ----------
    source : str
        File or URL of a JSON Web Key Set.
    issuer, audience : str or None
        Required claims ``iss`` and ``aud``.
    scope_claim : str
        Claim with scopes: a text with blanks, or a list.
    """

    def __init__(self, source: str, *, issuer: str | None, audience: str | None, scope_claim: str) -> None:
        self._source, self._issuer, self._audience, self._scope_claim = source, issuer, audience, scope_claim
        self._keys: dict[str, Any] = {}
        self._read_at_s = -READ_S
        self._lock = asyncio.Lock()
        self._remembered: OrderedDict[str, Verified] = OrderedDict()

    @classmethod
    def of_settings(cls, settings: Settings) -> Tokens | None:
        """The verifier of a server's settings; None if they name no key set."""
        if settings.jwt_jwks is None:
            return None
        return cls(
            settings.jwt_jwks,
            issuer=settings.jwt_issuer,
            audience=settings.jwt_audience,
            scope_claim=settings.jwt_scope_claim,
        )

    async def verify(self, text: str) -> Verified:
        """Subject, scopes and end (seconds since 1970) of a token; raises :class:`Unauthenticated`."""
        if time.monotonic() - self._read_at_s > READ_S:
            self._remembered.clear()
        found = self._remembered.get(text)
        if found is None:
            found = self._decoded(text, await self._key_of(text))
            self._remembered[text] = found
            while len(self._remembered) > MAX_REMEMBERED:
                self._remembered.popitem(last=False)
        if found[2] + LEEWAY_S <= time.time():
            self._remembered.pop(text, None)
            raise _refusal("the token has expired")
        return found

    async def _key_of(self, text: str) -> Any:
        import jwt

        try:
            header = jwt.get_unverified_header(text)
        except jwt.PyJWTError as err:
            raise _refusal("it is neither a key of this server nor a token") from err
        if header.get("alg") not in ALGORITHMS:
            raise _refusal(f"the token's algorithm is {str(header.get('alg'))[:20]!r}; known: {', '.join(ALGORITHMS)}")
        id = str(header.get("kid", ""))
        async with self._lock:
            age_s = time.monotonic() - self._read_at_s
            if age_s > READ_S or (id not in self._keys and age_s > EARLIEST_S):
                await self._read()
        key = self._keys.get(id)
        if key is None and not id and len(self._keys) == 1:
            key = next(iter(self._keys.values()))
        if key is None:
            raise _refusal("the token's key is not in the issuer's key set")
        return key

    def _decoded(self, text: str, key: Any) -> Verified:
        import jwt

        try:
            claims = jwt.decode(
                text,
                key=key,
                algorithms=list(ALGORITHMS),
                issuer=self._issuer,
                audience=self._audience,
                leeway=LEEWAY_S,
                options={"require": ["exp"], "verify_aud": self._audience is not None},
            )
        except jwt.PyJWTError as err:
            raise _refusal(f"the token is not valid: {err}"[:200]) from err
        given = claims.get(self._scope_claim, ())
        names = given.split() if isinstance(given, str) else given if isinstance(given, list) else ()
        scopes = frozenset(name for name in names if name in SCOPES)
        return str(claims.get("sub", "a token without subject"))[:80], scopes, float(claims["exp"])

    async def _read(self) -> None:
        """Read the issuer's keys; the earlier ones stay where that fails."""
        self._read_at_s = time.monotonic()
        try:
            content = await run_in_own_thread(partial(_content, self._source))
            self._keys = _keys(content)
        except (OSError, ValueError) as err:
            log.warning("the key set of tokens cannot be read", source=self._source, problem=str(err)[:200])
        self._remembered.clear()


def _content(source: str) -> bytes:
    """Bytes of the key set."""
    if not source.startswith(("http://", "https://")):
        return Path(source).read_bytes()[: MAX_BYTES + 1]
    from urllib.request import urlopen

    with urlopen(source, timeout=TIMEOUT_S) as response:
        return bytes(response.read(MAX_BYTES + 1))


def _keys(content: bytes) -> dict[str, Any]:
    """Keys of a set by id; raises ValueError."""
    import jwt

    if len(content) > MAX_BYTES:
        raise ValueError(f"it is longer than {MAX_BYTES} bytes")
    try:
        found = jwt.PyJWKSet.from_json(content.decode())
    except (jwt.PyJWTError, AttributeError, TypeError) as err:
        raise ValueError(str(err)) from err
    return {key.key_id or "": key for key in found.keys if key.algorithm_name in ALGORITHMS}


def _refusal(detail: str) -> Unauthenticated:
    return Unauthenticated(detail, headers={"WWW-Authenticate": 'Bearer realm="adverb", error="invalid_token"'})
