"""Record a stream and look at its numbers: how far the wrist is from a goal that jumps, and how fast it gets there.

Run: adverb serve, then python examples/07_record.py [ADDRESS] [FILE.npz or FILE.rrd]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from adverb_client import Client, Recorder, SyncStream

FPS = 60
GOALS = ((-0.3, 1.2, 0.4), (0.0, 1.4, 0.5), (-0.4, 0.9, 0.5))


def main(address: str = "http://127.0.0.1:8000", file: str = "") -> None:
    """Hold ``reach`` at its apex, where the wrist follows the goal, and let the goal jump once a second."""
    with Client(address) as client:
        verb = client.verb("reach")
    with SyncStream(address) as stream:
        channel = stream.open("reach", fps=FPS, play=False, phase=verb.keytimes["apex"], half_life=0.1)
        with Recorder(channel, verb.measure["effector"]) as recorder:
            for goal in GOALS:
                channel.aim(goal)
                time.sleep(1.0)
    recording = recorder.recording()  # arrays: times_s, goals, errors, root, rotations, …
    wrist = recording.positions()[:, recording.names.tolist().index(recording.effector)]
    distance_m = np.linalg.norm(wrist - recording.goals, axis=1)
    speed_m_s = np.linalg.norm(np.diff(wrist, axis=0), axis=1) / np.diff(recording.times_s)
    print(f"{len(recording)} frames, wrist up to {speed_m_s.max():.1f} m/s")
    print(f"distance to the goal {distance_m[-1] * 1e3:.1f} mm at the end, up to {np.nanmax(distance_m) * 1e3:.0f} mm")
    if file:
        recording.save(file)


if __name__ == "__main__":
    main(*sys.argv[1:])
