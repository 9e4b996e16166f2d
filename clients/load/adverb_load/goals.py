"""Goals for characters: walks through a verb's examples, so that goals stay near the examples."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
import numpy.typing as npt

__all__ = ["Goals", "RequestError", "base_of", "fetch"]

ANSWER_S = 10.0
"""Time in which a server has to answer."""

STEPS = 1_024
PER_EXAMPLE = 16
"""Steps from one example to the next."""

NEAR = 5
"""A walk continues at one of this number of nearest examples."""


class RequestError(Exception):
    """The server does not respond as expected."""


def base_of(url: str) -> str:
    """The server's REST address, from any of its addresses."""
    parts = urlsplit(url)
    scheme = {"ws": "http", "wss": "https"}.get(parts.scheme, parts.scheme)
    return f"{scheme}://{parts.netloc}"


def fetch(base: str, path: str, *, headers: Mapping[str, str] | None = None) -> dict[str, Any]:
    """A JSON response of the server; raises :class:`RequestError`."""
    request = urllib.request.Request(base + path, headers=dict(headers or {}))
    try:
        with urllib.request.urlopen(request, timeout=ANSWER_S) as response:
            found: dict[str, Any] = json.load(response)
            return found
    except urllib.error.HTTPError as err:
        content = err.read(4_096).decode("utf-8", "replace")
        raise RequestError(f"GET {path}: status {err.code}: {content}") from err
    except (OSError, ValueError) as err:
        raise RequestError(f"no server responds at {base}: {err}") from err


@dataclass(frozen=True, slots=True)
class Goals:
    """A walk through adverbs, repeated at its end.

    Parameters
    ----------
    names : list of str
        The verb's adverbs.
    rows : (S, D) float32
    packed : list of bytes
        The rows as bytes of a binary message.
    """

    names: list[str]
    rows: npt.NDArray[np.float32]
    packed: list[bytes]

    @classmethod
    def of(cls, verb: Mapping[str, Any], rng: np.random.Generator) -> Goals:
        """A walk from example to example of a verb as described by ``GET /v1/verbs/{verb}``."""
        names = [adverb["name"] for adverb in verb["adverbs"]]
        examples = np.array([[example["adverbs"][name] for name in names] for example in verb["examples"]])
        stops = examples[_stops(examples, rng, STEPS // PER_EXAMPLE + 1)]
        share = np.arange(PER_EXAMPLE)[:, None] / PER_EXAMPLE
        rows = (1 - share) * stops[:-1, None] + share * stops[1:, None]
        rows = rows.reshape(-1, len(names)).astype("<f4")
        return cls(names, rows, [row.tobytes() for row in rows])

    @classmethod
    def fetch(cls, base: str, verb: str, rng: np.random.Generator) -> Goals:
        """A walk through a verb of a server; raises :class:`RequestError`."""
        return cls.of(fetch(base, f"/v1/verbs/{quote(verb, safe='')}"), rng)

    def adverbs(self, step: int) -> dict[str, float]:
        """A step of the walk by name."""
        return dict(zip(self.names, self.rows[step % len(self.rows)].tolist(), strict=True))


def _stops(examples: npt.NDArray[np.float64], rng: np.random.Generator, count: int) -> npt.NDArray[np.int64]:
    """Indices of examples, each near the previous one."""
    spread = np.ptp(examples, axis=0)
    units = examples / np.where(spread > 0.0, spread, 1.0)
    apart = np.linalg.norm(units[:, None] - units[None], axis=2)
    near = np.argsort(apart, axis=1)[:, 1 : 1 + NEAR] if len(examples) > 1 else np.zeros((1, 1), np.int64)
    stops = np.empty(count, np.int64)
    stops[0] = rng.integers(len(examples))
    for k in range(1, count):
        stops[k] = rng.choice(near[stops[k - 1]])
    return stops
