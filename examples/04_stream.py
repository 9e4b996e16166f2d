"""Stream poses by WebSocket: the goal moves on a circle, and the displayed pose follows.

Run: adverb serve, then python examples/04_stream.py [ADDRESS] [SECONDS]
"""

from __future__ import annotations

import math
import sys
import time

from adverb_client import SyncStream

CENTRE, RADIUS_M, FPS = (-0.2, 1.2, 0.45), 0.1, 60


def main(address: str = "http://127.0.0.1:8000", seconds: str = "3") -> None:
    """Run a loop at 60 fps, as a game does: set the goal, take the newest pose."""
    shown = 0
    with SyncStream(address) as stream:
        channel = stream.open("reach", fps=FPS)
        for tick in range(int(float(seconds) * FPS)):
            angle = 2.0 * math.pi * tick / (2.0 * FPS)
            channel.aim([CENTRE[0] + RADIUS_M * math.cos(angle), CENTRE[1] + RADIUS_M * math.sin(angle), CENTRE[2]])
            pose = channel.pose()  # None before the first frame
            shown += pose is not None
            time.sleep(1.0 / FPS)
    print(f"{shown} poses displayed")


if __name__ == "__main__":
    main(*sys.argv[1:])
