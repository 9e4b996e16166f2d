"""Request one pose, a batch of poses and a whole motion by REST, and print the results.

python request_pose.py --url http://127.0.0.1:8000
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from adverb_client import Client


def main() -> None:
    """Send the requests and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server")
    parser.add_argument("--verb", default="reach", help="verb to request")
    options = parser.parse_args()
    with Client(options.url) as client:
        print(f"{client.wait_ready().verbs} verbs: {', '.join(row.name for row in client.verbs())}")
        verb = client.verb(options.verb)
        middle = {adverb.name: 0.5 * (adverb.min + adverb.max) for adverb in verb.adverbs}
        phase = verb.keytimes.get(verb.measure["keytime"] or "", 0.5)

        pose = client.pose(verb.name, middle, phase=phase)
        positions = verb.skeleton.positions(pose.root, pose.rotations)
        effector = verb.measure["effector"] or verb.skeleton.names[-1]
        at = ", ".join(f"{number:.3f}" for number in positions[verb.skeleton.index(effector)])
        print(f"{verb.name} at {_adverbs_text(middle)}: {effector} at ({at}) m, error {_error_text(pose.error)}")

        rng = np.random.default_rng(1)
        rows = rng.uniform([a.min for a in verb.adverbs], [a.max for a in verb.adverbs], (1000, len(verb.adverbs)))
        began = time.perf_counter()
        batch = client.poses(verb.name, rows, phases=rng.uniform(0.0, 1.0, 1000))
        took_ms = 1e3 * (time.perf_counter() - began)
        print(
            f"a batch of {len(batch)} poses in {took_ms:.0f} ms; {batch.clamped.mean():.0%} were clamped to the domain"
        )

        motion = client.sequence(verb.name, middle, fps=30, full=True)
        keytimes = ", ".join(f"{event.name} at {event.time_s:.2f} s" for event in motion.events or ())
        print(f"{len(motion)} frames, {motion.duration_s:.2f} s: {keytimes}")


def _adverbs_text(adverbs: dict[str, float]) -> str:
    return ", ".join(f"{name} {number:.2f}" for name, number in adverbs.items())


def _error_text(error: float | None) -> str:
    return "not measured" if error is None else f"{1e3 * error:.3g} mm"


if __name__ == "__main__":
    main()
