"""API keys: random texts with a public id, stored as hashes.

A key is ``adv_ID_SECRET``: 16 hexadecimal digits, and 256 random bits as base64url. A random secret of this length
needs no slow hash: there are too many to try.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets

from service.store.records import Key

__all__ = ["FORM", "SCOPES", "hash_of", "id_of", "matches", "new"]

SCOPES = ("pose", "author", "refine", "admin")
"""All scopes; ``admin`` includes the others."""

FORM = re.compile(r"adv_([0-9a-f]{16})_[A-Za-z0-9_-]{43}")
"""What a key looks like."""


def new() -> tuple[str, str]:
    """Id and text of a new key."""
    id = secrets.token_hex(8)
    return id, f"adv_{id}_{secrets.token_urlsafe(32)}"


def id_of(text: str) -> str | None:
    """Id of a key; None for another text."""
    found = FORM.fullmatch(text)
    return found[1] if found else None


def hash_of(text: str) -> str:
    """SHA-256 of a key, 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def matches(text: str, key: Key) -> bool:
    """Whether a text is this key, compared in constant time."""
    return hmac.compare_digest(hash_of(text), key.sha256)
