"""The server under load: its address, the key, and descriptions of its verbs."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
import numpy.typing as npt

from adverb_load.effector import Effector
from adverb_load.goals import Goals, RequestError, fetch

__all__ = ["Target", "VerbInfo", "is_loopback"]

SCHEMES = {"ws": "http", "wss": "https", "http": "http", "https": "https"}


def is_loopback(url: str) -> bool:
    """Whether an address is one of this machine's loopback addresses."""
    host = urlsplit(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True, eq=False)
class VerbInfo:
    """What a load needs of a verb.

    Parameters
    ----------
    name : str
    goals : Goals
        A walk through its examples.
    effector : Effector or None
        None if the verb is not measured by the position of a joint.
    joints : int
    """

    name: str
    goals: Goals
    effector: Effector | None
    joints: int

    def row(self, step: int) -> npt.NDArray[np.float32]:
        """Adverbs (D,) of a step of the walk, which repeats."""
        found: npt.NDArray[np.float32] = self.goals.rows[step % len(self.goals.rows)]
        return found


@dataclass(slots=True)
class Target:
    """A server.

    Parameters
    ----------
    url : str
        Any of its addresses: ``http``, ``https``, ``ws`` or ``wss``; the path is ignored.
    key : str
        Sent as a bearer token; empty for none.
    seed : int
        Of the walks.
    """

    url: str
    key: str = ""
    seed: int = 1
    _verbs: dict[str, VerbInfo] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme not in SCHEMES or not parts.hostname:
            raise RequestError(f"'{self.url}' is not the address of a server; expected http://HOST:PORT")
        self.url = f"{SCHEMES[parts.scheme]}://{parts.netloc}"

    @property
    def stream_url(self) -> str:
        """Address of the stream."""
        return self.url.replace("http", "ws", 1) + "/v1/stream"

    @property
    def headers(self) -> dict[str, str]:
        """Headers of every request."""
        return {"Authorization": f"Bearer {self.key}"} if self.key else {}

    def fetch(self, path: str) -> dict[str, Any]:
        """A JSON response; raises :class:`RequestError`."""
        return fetch(self.url, path, headers=self.headers)

    def verb(self, name: str) -> VerbInfo:
        """The description of a verb, requested once; raises :class:`RequestError`."""
        if name not in self._verbs:
            found = self.fetch(f"/v1/verbs/{quote(name, safe='')}")
            goals = Goals.of(found, np.random.default_rng(self.seed))
            self._verbs[name] = VerbInfo(name, goals, Effector.of(found), len(found["skeleton"]["names"]))
        return self._verbs[name]
