"""Request a crowd in one call: a thousand poses at random goals and phases.

Run: adverb serve, then python examples/03_crowd.py [ADDRESS]
"""

from __future__ import annotations

import sys

import numpy as np
from adverb_client import Client

COUNT = 1_000


def main(address: str = "http://127.0.0.1:8000") -> None:
    """Request poses of the built-in verb ``reach`` as one binary batch."""
    rng = np.random.default_rng(1)
    with Client(address) as client:
        client.wait_ready()
        adverbs = client.verb("reach").adverbs
        goals = rng.uniform([one.min for one in adverbs], [one.max for one in adverbs], (COUNT, len(adverbs)))
        crowd = client.poses("reach", goals, phases=rng.uniform(0.0, 1.0, COUNT))
        print(
            f"{len(crowd)} poses, rotations {crowd.rotations.shape}, {crowd.clamped.mean():.0%} clamped to the domain"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
