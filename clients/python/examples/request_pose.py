"""Ask for one pose, a crowd and a whole motion by REST, and print what came.

python request_pose.py --url http://127.0.0.1:8000
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from adverb_client import Client


def main() -> None:
    """Ask and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="where the server is")
    parser.add_argument("--verb", default="reach", help="which verb to ask for")
    options = parser.parse_args()
    with Client(options.url) as client:
        print(f"{client.wait_ready().verbs} verbs: {', '.join(row.name for row in client.verbs())}")
        verb = client.verb(options.verb)
        middle = {adverb.name: 0.5 * (adverb.min + adverb.max) for adverb in verb.adverbs}
        at = verb.keytimes.get(verb.measure["keytime"] or "", 0.5)

        pose = client.pose(verb.name, middle, phase=at)
        places = verb.skeleton.positions(pose.root, pose.rotations)
        effector = verb.measure["effector"] or verb.skeleton.names[-1]
        where = ", ".join(f"{number:.3f}" for number in places[verb.skeleton.index(effector)])
        print(f"{verb.name} at {_said(middle)}: {effector} at ({where}) m, error {_said_error(pose.error)}")

        rng = np.random.default_rng(1)
        rows = rng.uniform([a.min for a in verb.adverbs], [a.max for a in verb.adverbs], (1000, len(verb.adverbs)))
        began = time.perf_counter()
        crowd = client.poses(verb.name, rows, phases=rng.uniform(0.0, 1.0, 1000))
        took_ms = 1e3 * (time.perf_counter() - began)
        print(f"a crowd of {len(crowd)} in {took_ms:.0f} ms; {crowd.clamped.mean():.0%} were drawn back to the domain")

        motion = client.sequence(verb.name, middle, fps=30, full=True)
        passed = ", ".join(f"{event.name} at {event.time_s:.2f} s" for event in motion.events or ())
        print(f"{len(motion)} frames, {motion.duration_s:.2f} s: {passed}")


def _said(adverbs: dict[str, float]) -> str:
    return ", ".join(f"{name} {number:.2f}" for name, number in adverbs.items())


def _said_error(error: float | None) -> str:
    return "not measured" if error is None else f"{1e3 * error:.3g} mm"


if __name__ == "__main__":
    main()
