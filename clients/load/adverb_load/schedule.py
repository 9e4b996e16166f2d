"""Arrivals of an open loop: absolute times that do not depend on how fast the server responds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

__all__ = ["ARRIVALS", "arrivals"]

ARRIVALS = ("constant", "poisson")
CHUNK = 1_024


def arrivals(rate_hz: float, kind: str, rng: np.random.Generator) -> Iterator[float]:
    """Seconds from the start at which something is due, without end.

    Parameters
    ----------
    rate_hz : float
        Mean rate, above 0.
    kind : str
        ``constant``: equal intervals from a random first one; ``poisson``: exponential intervals.
    rng : numpy.random.Generator

    Raises
    ------
    ValueError
        If the kind is unknown or the rate is not positive.
    """
    if kind not in ARRIVALS or not rate_hz > 0.0:
        raise ValueError(f"arrivals '{kind}' at {rate_hz:g} Hz; expected {' or '.join(ARRIVALS)} at more than 0 Hz")
    return _constant(rate_hz, rng) if kind == "constant" else _poisson(rate_hz, rng)


def _constant(rate_hz: float, rng: np.random.Generator) -> Iterator[float]:
    first, k = rng.random(), 0
    while True:
        yield (first + k) / rate_hz
        k += 1


def _poisson(rate_hz: float, rng: np.random.Generator) -> Iterator[float]:
    time_s = 0.0
    while True:
        for gap_s in rng.exponential(1.0 / rate_hz, CHUNK).tolist():
            time_s += gap_s
            yield time_s
