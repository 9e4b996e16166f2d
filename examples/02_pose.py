"""Request one pose by REST: the right hand at a point, with the measured error.

Run: adverb serve, then python examples/02_pose.py [ADDRESS]
"""

from __future__ import annotations

import sys

from adverb_client import Client

GOAL = {"x": -0.3, "y": 1.2, "z": 0.4}


def main(address: str = "http://127.0.0.1:8000") -> None:
    """Request a pose of the built-in verb ``reach`` and print the position of the wrist."""
    with Client(address) as client:
        client.wait_ready()
        verb = client.verb("reach")
        pose = client.pose("reach", GOAL, phase=verb.keytimes["apex"])
        positions = verb.skeleton.positions(pose.root, pose.rotations)
        x, y, z = positions[verb.skeleton.index("RightHand")]
        print(f"wrist at {x:.3f} {y:.3f} {z:.3f} m, error {1e3 * (pose.error or 0.0):.1e} mm")


if __name__ == "__main__":
    main(*sys.argv[1:])
