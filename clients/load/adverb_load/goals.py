"""Where to send characters: walks through a verb's examples, so that goals are where the verb has something to show."""

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

__all__ = ["CannotAsk", "Goals", "base_of", "fetch"]

STEPS = 1_024
PER_EXAMPLE = 16
"""Steps from one example to the next."""

NEAR = 5
"""A walk goes on to one of so many nearest examples, so that it stays where the examples are."""


class CannotAsk(Exception):
    """The server does not answer as it should; the message says what it did."""


def base_of(url: str) -> str:
    """The server's REST address, from that of its stream or its own."""
    parts = urlsplit(url)
    scheme = {"ws": "http", "wss": "https"}.get(parts.scheme, parts.scheme)
    return f"{scheme}://{parts.netloc}"


def fetch(base: str, path: str, *, timeout_s: float = 10.0) -> dict[str, Any]:
    """A JSON object of the server; raises :class:`CannotAsk`."""
    try:
        with urllib.request.urlopen(base + path, timeout=timeout_s) as answer:
            found: dict[str, Any] = json.load(answer)
            return found
    except urllib.error.HTTPError as err:
        said = err.read(4_096).decode("utf-8", "replace")
        raise CannotAsk(f"GET {path} was answered {err.code}: {said}") from err
    except (OSError, ValueError) as err:
        raise CannotAsk(f"no server answers at {base}: {err}") from err


@dataclass(frozen=True, slots=True)
class Goals:
    """A walk through adverbs, which is begun again when it ends.

    Parameters
    ----------
    names : list of str
        The verb's adverbs.
    rows : (S, D) float32
    packed : list of bytes
        The rows as a stream takes them.
    """

    names: list[str]
    rows: npt.NDArray[np.float32]
    packed: list[bytes]

    @classmethod
    def of(cls, verb: Mapping[str, Any], rng: np.random.Generator) -> Goals:
        """A walk from example to example of a verb as ``GET /v1/verbs/{verb}`` tells of it."""
        names = [adverb["name"] for adverb in verb["adverbs"]]
        examples = np.array([[example["adverbs"][name] for name in names] for example in verb["examples"]])
        stops = examples[_stops(examples, rng, STEPS // PER_EXAMPLE + 1)]
        share = np.arange(PER_EXAMPLE)[:, None] / PER_EXAMPLE
        rows = (1 - share) * stops[:-1, None] + share * stops[1:, None]
        rows = rows.reshape(-1, len(names)).astype("<f4")
        return cls(names, rows, [row.tobytes() for row in rows])

    @classmethod
    def ask(cls, base: str, verb: str, rng: np.random.Generator) -> Goals:
        """The walk through a verb that a server has; raises :class:`CannotAsk`."""
        return cls.of(fetch(base, f"/v1/verbs/{quote(verb, safe='')}"), rng)

    def adverbs(self, step: int) -> dict[str, float]:
        """A step of the walk by name."""
        return dict(zip(self.names, self.rows[step % len(self.rows)].tolist(), strict=True))


def _stops(examples: npt.NDArray[np.float64], rng: np.random.Generator, count: int) -> npt.NDArray[np.int64]:
    """Examples one after the other, each near the one before."""
    spread = np.ptp(examples, axis=0)
    units = examples / np.where(spread > 0.0, spread, 1.0)
    apart = np.linalg.norm(units[:, None] - units[None], axis=2)
    near = np.argsort(apart, axis=1)[:, 1 : 1 + NEAR] if len(examples) > 1 else np.zeros((1, 1), np.int64)
    stops = np.empty(count, np.int64)
    stops[0] = rng.integers(len(examples))
    for k in range(1, count):
        stops[k] = rng.choice(near[stops[k - 1]])
    return stops
